"""The parallel-jaw gripper: its data sheet, and the boxes it is made of.

Tool frame (TCP): centre between the finger tip ends, z is the approach direction, x the closing direction.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import Field

from cell.bin import Box
from cell.config import Config, load
from cell.errors import InputError
from cell.frames import Array, make_transform

SHIPPED = Path(__file__).resolve().parent / "grippers"

Triple = tuple[float, float, float]


class BodyBox(Config):
    """A box that does not move with the fingers: full edge lengths and centre in the flange frame [m]."""

    name: str
    size: Triple
    centre: Triple


class GripperConfig(Config):
    """Schema of a gripper's YAML file."""

    name: str
    max_opening: float = Field(gt=0, le=0.5, description="[m] between the pads")
    finger_size: Triple = Field(description="[m] thickness along x, width along y, length along z")
    flange_to_tcp: float = Field(gt=0, le=1, description="[m]")
    body: list[BodyBox] = Field(min_length=1)
    body_mass: float = Field(gt=0, description="[kg]")
    finger_mass: float = Field(gt=0, description="[kg] of each")
    force: float = Field(gt=0, le=1000, description="[N] of each pad")
    speed: float = Field(gt=0, le=2, description="[m/s] of each finger")
    friction: float = Field(gt=0, le=2, description="of the pads, see cell.world.engine_friction")


@dataclass(frozen=True)
class Gripper:
    """A parallel jaw whose fingers move symmetrically along the tool's x axis.

    Boxes are returned in the tool frame: their `T_world_box` is then T_tool_box. `in_frame` moves them elsewhere.

    Attributes:
        finger_size: thickness along x, width along y, length along z, in [m].
        force: normal force of each pad in [N]; speed: of each finger in [m/s].
        T_flange_tool: (4, 4), read-only.
    """

    name: str
    max_opening: float
    finger_size: Triple
    body: tuple[BodyBox, ...]
    body_mass: float
    finger_mass: float
    force: float
    speed: float
    friction: float
    T_flange_tool: Array

    def body_boxes(self) -> list[Box]:
        """The boxes that do not move with the fingers."""
        to_tool = np.linalg.inv(self.T_flange_tool)
        return [Box(b.name, b.size, to_tool @ make_transform(t=b.centre)) for b in self.body]

    def finger_boxes(self, opening: float) -> list[Box]:
        """Both fingers when their pads are `opening` [m] apart."""
        thickness, _, length = self.finger_size
        x = (opening + thickness) / 2
        return [
            Box("finger_left", self.finger_size, make_transform(t=(-x, 0.0, -length / 2))),
            Box("finger_right", self.finger_size, make_transform(t=(x, 0.0, -length / 2))),
        ]

    def boxes(self, opening: float) -> list[Box]:
        """Body and fingers."""
        return [*self.body_boxes(), *self.finger_boxes(opening)]

    def flange_boxes(self, opening: float) -> list[Box]:
        """Body and fingers in the flange frame, for the collision model of an arm."""
        return in_frame(self.boxes(opening), self.T_flange_tool)


def in_frame(boxes: list[Box], T_a_b: Array) -> list[Box]:
    """The same boxes, given in frame b, in frame a."""
    return [Box(box.name, box.size, T_a_b @ box.T_world_box) for box in boxes]


def list_grippers() -> list[str]:
    """Names of the shipped grippers."""
    return sorted(path.stem for path in SHIPPED.glob("*.yaml"))


def load_gripper(name: str) -> Gripper:
    """Load a shipped gripper by name, or any by the path of its YAML file.

    Raises:
        InputError: no such gripper, or an invalid file.
    """
    path = Path(name) if name.endswith((".yaml", ".yml")) else SHIPPED / f"{name}.yaml"
    if not path.is_file():
        raise InputError("command line", "gripper", name, f"one of: {', '.join(list_grippers())}, or a YAML file")
    config = load(GripperConfig, path)
    T_flange_tool = make_transform(t=(0.0, 0.0, config.flange_to_tcp))
    T_flange_tool.flags.writeable = False
    return Gripper(
        name=config.name,
        max_opening=config.max_opening,
        finger_size=config.finger_size,
        body=tuple(config.body),
        body_mass=config.body_mass,
        finger_mass=config.finger_mass,
        force=config.force,
        speed=config.speed,
        friction=config.friction,
        T_flange_tool=T_flange_tool,
    )
