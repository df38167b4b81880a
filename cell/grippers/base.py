"""Base of all grippers: a body at the flange, a TCP, parts that touch workpieces, and the shapes of these parts.

Tool frame (TCP): z is the approach direction. The TCP of a jaw lies between its finger tips, with x as the closing
direction. The TCP of cups and magnets is the centre of the face that holds the workpiece.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from pickproof.cell.config import Config, Length, OffsetPoint, Size
from pickproof.cell.frames import Array, make_transform
from pickproof.cell.geometry.bin import Box
from pickproof.cell.workpiece.collision_pieces import CollisionBox, CollisionCylinder

Triple = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0)]


class BodyBox(Config):
    """A box that does not move with the fingers: full edge lengths and centre in the flange frame [m]."""

    name: str = Field(description="any, not beginning with `finger`")
    size: Size = Field(description="[m] full edge lengths")
    centre: OffsetPoint = Field(description="[m] in the flange frame")


class ToolConfig(Config):
    """Fields of the YAML file of every gripper."""

    name: str = Field(description="records and grasp tables refer to it")
    flange_to_tcp: Length = Field(description="[m]")
    body: list[BodyBox] = Field(min_length=1, description="boxes that collide and do not move with the fingers")
    body_mass: float = Field(gt=0, description="[kg]")


@dataclass(frozen=True)
class Pad:
    """Compliance of a touching surface: stiffness [N/m] and damping [N s/m] of each contact point."""

    stiffness: float
    damping: float


@dataclass(frozen=True)
class ToolLink:
    """A part of the gripper that touches workpieces, and slides along `axis` (3,) of the flange frame.

    Attributes:
        shapes: in the flange frame, at travel 0.
        mass: in [kg]; travel: largest displacement in [m]; speed: in [m/s].
        friction: see `cell.physics.world.engine_friction`; pad: None for a hard surface.
    """

    name: str
    shapes: tuple[CollisionBox | CollisionCylinder, ...]
    mass: float
    axis: Triple
    travel: float
    speed: float
    friction: float
    pad: Pad | None = None


@dataclass(frozen=True, kw_only=True)
class Gripper(ABC):
    """What all kinds of grippers have in common.

    Boxes are returned in the tool frame: their `T_world_box` is then T_tool_box. `in_frame` moves them elsewhere. The
    boxes of parts that may touch a workpiece have names that begin with `finger`, for every kind of gripper.

    Attributes:
        body_mass: in [kg].
        T_flange_tool: (4, 4), read-only.
    """

    name: str
    body: tuple[BodyBox, ...]
    body_mass: float
    T_flange_tool: Array

    @property
    def max_opening(self) -> float:
        """Widest distance of the pads in [m]; 0 without jaws."""
        return 0.0

    @property
    def mass(self) -> float:
        """Mass in [kg] of everything mounted on the flange."""
        return self.body_mass + sum(link.mass for link in self.links())

    @property
    def centre(self) -> Array:
        """Centre of mass (3,) in the flange frame in [m]; boxes have equal density, moving parts are at travel 0."""
        boxes = [(float(np.prod(b.size)), np.array(b.centre)) for b in self.body]
        body = sum(volume * centre for volume, centre in boxes) / sum(volume for volume, _ in boxes)
        moving = [(link.mass, np.mean([shape.centre for shape in link.shapes], axis=0)) for link in self.links()]
        return np.asarray((self.body_mass * body + sum(mass * centre for mass, centre in moving)) / self.mass)

    def body_boxes(self) -> list[Box]:
        """The boxes that do not move with the fingers."""
        to_tool = np.linalg.inv(self.T_flange_tool)
        return [Box(b.name, b.size, to_tool @ make_transform(t=b.centre)) for b in self.body]

    @abstractmethod
    def finger_boxes(self, opening: float) -> list[Box]:
        """Boxes around the parts that may touch a workpiece, with the pads `opening` [m] apart."""

    @abstractmethod
    def links(self) -> tuple[ToolLink, ...]:
        """The parts that may touch a workpiece, as the physics models them."""

    def boxes(self, opening: float) -> list[Box]:
        """Body and fingers."""
        return [*self.body_boxes(), *self.finger_boxes(opening)]

    def flange_boxes(self, opening: float) -> list[Box]:
        """Body and fingers in the flange frame, for the collision model of an arm."""
        return in_frame(self.boxes(opening), self.T_flange_tool)


def in_frame(boxes: list[Box], T_a_b: Array) -> list[Box]:
    """The same boxes, given in frame b, in frame a."""
    return [Box(box.name, box.size, T_a_b @ box.T_world_box) for box in boxes]


def tcp(flange_to_tcp: float) -> Array:
    """T_flange_tool (4, 4), read-only, of a TCP straight in front of the flange."""
    T_flange_tool = make_transform(t=(0.0, 0.0, flange_to_tcp))
    T_flange_tool.flags.writeable = False
    return T_flange_tool
