"""The parallel jaw: two fingers driven symmetrically by one motor, with flat or grooved, hard or padded faces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from pickproof.cell.config import Config, Small
from pickproof.cell.frames import make_transform
from pickproof.cell.geometry.bin import Box
from pickproof.cell.grippers.base import Gripper, Pad, Positive, ToolConfig, ToolLink, Triple, tcp
from pickproof.cell.workpiece.collision_pieces import CollisionBox

FINGERS = ("finger_left", "finger_right")


class Groove(Config):
    """A V cut along y into the face of each finger, for round workpieces that lie across the jaws.

    `above_tip` is the height of its middle over the tip end, `height` its width at the face along z, both in [m];
    `half_angle_deg` is that between either flank and the closing direction.
    """

    above_tip: Small = Field(description="[m] height of its middle over the tip end")
    height: Small = Field(description="[m] width at the face, along z")
    half_angle_deg: float = Field(60.0, ge=20, le=85, description="between either flank and the closing direction")

    @property
    def depth(self) -> float:
        """Depth of the groove in [m]."""
        return self.height / 2 / float(np.tan(np.deg2rad(self.half_angle_deg)))


class PadConfig(Config):
    """A compliant face: stiffness and damping of each of its contact points."""

    stiffness: Positive = Field(description="[N/m]")
    damping: Positive = Field(description="[N s/m]")


class JawConfig(ToolConfig):
    """Schema of a parallel jaw's YAML file."""

    kind: Literal["parallel_jaw"] = Field("parallel_jaw", description="a jaw with two fingers")
    max_opening: Small = Field(description="[m] between the pads")
    finger_size: tuple[Small, Small, Small] = Field(description="[m] thickness along x, width along y, length along z")
    groove: Groove | None = Field(None, description="V along y in each face, for round parts across the jaws")
    pad: PadConfig | None = Field(None, description="compliant faces; hard ones when left out")
    finger_mass: float = Field(gt=0, description="[kg] of each")
    force: float = Field(gt=0, le=1000, description="[N] of each pad")
    speed: float = Field(gt=0, le=2, description="[m/s] of each finger")
    friction: float = Field(gt=0, le=2, description="of the pads, see cell/physics/world.py")

    @model_validator(mode="after")
    def _fits(self) -> JawConfig:
        g, (thickness, _, length) = self.groove, self.finger_size
        if g is not None and (g.depth >= thickness or not g.height / 2 < g.above_tip < length - g.height / 2):
            raise ValueError(f"the groove ({1e3 * g.depth:.1f} mm deep) does not fit into the finger")
        return self

    def build(self) -> ParallelJaw:
        """The gripper."""
        return ParallelJaw(
            name=self.name,
            opens_to=self.max_opening,
            finger_size=self.finger_size,
            groove=self.groove,
            pad=None if self.pad is None else Pad(self.pad.stiffness, self.pad.damping),
            body=tuple(self.body),
            body_mass=self.body_mass,
            finger_mass=self.finger_mass,
            force=self.force,
            speed=self.speed,
            friction=self.friction,
            T_flange_tool=tcp(self.flange_to_tcp),
        )


@dataclass(frozen=True, kw_only=True)
class ParallelJaw(Gripper):
    """A parallel jaw whose fingers move symmetrically along the tool's x axis.

    Attributes:
        opens_to: widest distance of the pads in [m].
        finger_size: thickness along x, width along y, length along z, in [m].
        groove: cut into the faces; the opening is measured between the faces beside it.
        force: normal force of each pad in [N]; speed: of each finger in [m/s].
    """

    opens_to: float
    finger_size: Triple
    groove: Groove | None
    pad: Pad | None
    finger_mass: float
    force: float
    speed: float
    friction: float

    @property
    def max_opening(self) -> float:
        """[m] between the fingers when the gripper is fully open."""
        return self.opens_to

    def finger_boxes(self, opening: float) -> list[Box]:
        """Both fingers, grooves filled up, when their pads are `opening` [m] apart."""
        thickness, _, length = self.finger_size
        x = (opening + thickness) / 2
        return [
            Box(FINGERS[0], self.finger_size, make_transform(t=(-x, 0.0, -length / 2))),
            Box(FINGERS[1], self.finger_size, make_transform(t=(x, 0.0, -length / 2))),
        ]

    def links(self) -> tuple[ToolLink, ...]:
        """The left and the right finger; travel is 0 when the pads meet."""
        shapes: list[tuple[CollisionBox, ...]] = []
        for box, side in zip(self.finger_boxes(0.0), (-1.0, 1.0), strict=True):
            T = self.T_flange_tool @ box.T_world_box
            if self.groove is None:
                shapes.append((CollisionBox(size=box.size, centre=tuple(T[:3, 3].tolist())),))
            else:
                shapes.append(_grooved(self.finger_size, self.groove, side, float(self.T_flange_tool[2, 3])))
        return tuple(
            ToolLink(name, pieces, self.finger_mass, axis, self.max_opening / 2, self.speed, self.friction, self.pad)
            for name, pieces, axis in zip(FINGERS, shapes, ((-1.0, 0.0, 0.0), (1.0, 0.0, 0.0)), strict=True)
        )


def _grooved(size: Triple, groove: Groove, side: float, tip_z: float) -> tuple[CollisionBox, ...]:
    """A finger with its face at x = 0 and its body towards `side`: back, lands over and under the groove, flanks."""
    (thickness, width, length), h, depth = size, groove.height / 2, groove.depth
    middle, alpha = tip_z - groove.above_tip, np.deg2rad(groove.half_angle_deg)

    def block(x: tuple[float, float], z: tuple[float, float]) -> CollisionBox:
        centre = (side * (x[0] + x[1]) / 2, 0.0, (z[0] + z[1]) / 2)
        return CollisionBox(size=(x[1] - x[0], width, z[1] - z[0]), centre=centre)

    pieces = [
        block((depth, thickness), (tip_z - length, tip_z)),
        block((0.0, depth), (tip_z - length, middle - h)),
        block((0.0, depth), (middle + h, tip_z)),
    ]
    slab = min(thickness - depth, depth * float(np.sin(alpha)))
    for up in (-1.0, 1.0):  # a flank is the face of a slab that lies within the finger
        along = np.array([side * depth, 0.0, -up * h])  # from the edge at the face to the bottom of the V
        behind = np.array([side * h, 0.0, up * depth]) / np.hypot(h, depth)
        centre = np.array([0.0, 0.0, middle + up * h]) + along / 2 + behind * slab / 2
        pitch = float(np.arctan2(-along[2], along[0]))  # turns x onto the flank
        pieces.append(
            CollisionBox(
                size=(float(np.hypot(h, depth)), width, slab), centre=tuple(centre.tolist()), rpy=(0.0, pitch, 0.0)
            )
        )
    return tuple(pieces)
