"""Cups and magnets, which take a workpiece from one side: faces on a sprung slide that hold what they touch."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import Field

from pickproof.cell.config import Offset, Small
from pickproof.cell.frames import Array, make_transform
from pickproof.cell.geometry.bin import Box
from pickproof.cell.grippers.base import Gripper, Positive, ToolConfig, ToolLink, tcp
from pickproof.cell.grippers.one_sided_hold import Hold
from pickproof.cell.workpiece.collision_pieces import CollisionCylinder

SLIDE_SPEED = 1.0  # [m/s]
TOUCH = 0.001  # [m] gap up to which a face counts as touching; collision shapes deviate from their CAD by less
GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))


@dataclass(frozen=True)
class Surface:
    """Hits of rays along the approach direction.

    Attributes:
        gap: (n,) [m] from the face's plane, infinite where nothing is hit.
        cosine: (n,) of the angle between the outward normal and the direction back to the face.
        part: (n,) index of the workpiece, -1 for none.
    """

    gap: Array
    cosine: Array
    part: np.ndarray


Probe = Callable[[Array], Surface]
"""Surface under points (n, 2) of the tool's xy plane."""


class OneSidedConfig(ToolConfig):
    """What cups and magnets have in common."""

    diameter: Small = Field(description="[m] of each lip or face")
    height: Small = Field(description="[m] of each")
    centres: tuple[tuple[Offset, Offset], ...] = Field(((0.0, 0.0),), min_length=1, description="(x, y) of each [m]")
    stroke: Small = Field(description="[m] by which the faces give way towards the flange")
    stiffness: Positive = Field(description="[N/m] of the spring behind each face")
    preload: Positive = Field(description="[N] of the spring behind each face: more than the weight of the slide")
    face_mass: Positive = Field(description="[kg] of all that slides")
    friction: float = Field(gt=0, le=2, description="between face and workpiece")
    switch_time: Positive = Field(description="[s] from switching on until it holds, and from off until it lets go")

    def fields(self) -> dict[str, Any]:
        """Constructor arguments of the gripper of this file."""
        same = {k: getattr(self, k) for k in type(self).model_fields if k not in ("kind", "flange_to_tcp", "body")}
        return same | {"body": tuple(self.body), "T_flange_tool": tcp(self.flange_to_tcp)}


@dataclass(frozen=True, kw_only=True)
class OneSidedGripper(Gripper):
    """Cups or magnets, all of one kind, whose faces end in one plane through the TCP.

    Attributes are those of `OneSidedConfig`.
    """

    diameter: float
    height: float
    centres: tuple[tuple[float, float], ...]
    stroke: float
    stiffness: float
    preload: float
    face_mass: float
    friction: float
    switch_time: float

    @property
    def radius(self) -> float:
        """Radius of each face in [m]."""
        return self.diameter / 2

    def finger_boxes(self, opening: float) -> list[Box]:
        """A box around each face; `opening` has no effect."""
        size = (self.diameter, self.diameter, self.height)
        return [
            Box(f"finger_{k}", size, make_transform(t=(x, y, -self.height / 2)))
            for k, (x, y) in enumerate(self.centres)
        ]

    def links(self) -> tuple[ToolLink, ...]:
        """All faces on one slide."""
        z = float(self.T_flange_tool[2, 3]) - self.height / 2
        shapes = tuple(CollisionCylinder(radius=self.radius, length=self.height, centre=(*c, z)) for c in self.centres)
        return (
            ToolLink("finger_faces", shapes, self.face_mass, (0.0, 0.0, -1.0), self.stroke, SLIDE_SPEED, self.friction),
        )

    def spring_force(self, travel: float) -> float:
        """Force in [N] with which the faces press when their springs are compressed by `travel` [m]."""
        return len(self.centres) * (self.preload + self.stiffness * max(travel, 0.0))

    @abstractmethod
    def take(
        self, probe: Probe, magnetic: Callable[[int], bool], travel: float = 0.0
    ) -> tuple[dict[int, list[Hold]], tuple[str, ...]]:
        """Holds by workpiece, and for each face why it holds nothing (empty where it holds).

        `travel` [m] is the compression of the springs behind the faces.
        """


def disc(radius: float, n: int) -> Array:
    """Points (n, 2) spread evenly over a disc (sunflower pattern); each stands for the same area."""
    k = np.arange(n) + 0.5
    r, phi = radius * np.sqrt(k / n), GOLDEN_ANGLE * k
    return np.stack([r * np.cos(phi), r * np.sin(phi)], axis=1)


def ring(radius: float, n: int) -> Array:
    """Points (n, 2) on a circle."""
    phi = 2 * np.pi * np.arange(n) / n
    return radius * np.stack([np.cos(phi), np.sin(phi)], axis=1)
