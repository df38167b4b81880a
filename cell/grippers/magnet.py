"""Holding magnets: force over gap and contact area.

Maxwell's pull B^2 A / (2 mu0), with the flux of a magnetic circuit whose reluctance grows with the air gap: a gap g
lowers the field to 1 / (1 + g / g0) and the force to its square. It is summed over the face, ray by ray, so that a
smaller or curved surface holds less.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from pickproof.cell.config import Fine
from pickproof.cell.grippers.base import Positive
from pickproof.cell.grippers.one_sided import TOUCH, OneSidedConfig, OneSidedGripper, Probe, disc
from pickproof.cell.grippers.one_sided_hold import Hold

FACE_RAYS = 120


class MagnetConfig(OneSidedConfig):
    """Schema of a magnet's YAML file."""

    kind: Literal["magnet"] = Field(description="magnets")
    force: Positive = Field(description="[N] of each face on thick, flat, bare steel")
    gap_scale: Fine = Field(gt=0, description="[m] gap at which a quarter of the force is left")
    cover: Fine = Field(0.0, description="[m] thickness of a layer on the face that is not magnetic")

    def build(self) -> Magnet:
        """The gripper."""
        return Magnet(**self.fields())


@dataclass(frozen=True, kw_only=True)
class Magnet(OneSidedGripper):
    """One round magnet or several; attributes are those of `MagnetConfig`."""

    force: float
    gap_scale: float
    cover: float

    def pull(self, gap: float) -> float:
        """Force in [N] of a whole face at a uniform gap [m] under the cover."""
        return float(self.force / (1.0 + (gap + self.cover) / self.gap_scale) ** 2)

    def take(
        self, probe: Probe, magnetic: Callable[[int], bool], travel: float = 0.0
    ) -> tuple[dict[int, list[Hold]], tuple[str, ...]]:
        """Every magnetic workpiece that a face touches is held by the share of the face that covers it."""
        holds: dict[int, list[Hold]] = {}
        reasons = []
        for centre in self.centres:
            points = disc(self.radius, FACE_RAYS)
            surface = probe(points + centre)
            touched = [int(p) for p in np.unique(surface.part[surface.part >= 0])]
            touched = [p for p in touched if surface.gap[surface.part == p].min() <= TOUCH]
            strong = [p for p in touched if magnetic(p)]
            for part in strong:
                mine = surface.part == part
                pulls = np.array([self.pull(max(float(g), 0.0)) for g in surface.gap[mine]]) / FACE_RAYS
                offset = pulls @ points[mine] / pulls.sum()
                # the face tips over the edge of what it rests on: a disc of the same area as the rays that touch
                resting = float(np.mean(mine & (surface.gap <= surface.gap[mine].min() + TOUCH)))
                lever = self.radius * float(np.sqrt(resting))
                at = (centre[0] + float(offset[0]), centre[1] + float(offset[1]))
                hold = Hold(at, lever, float(pulls.sum()), self.friction, lever, 2 / 3 * lever)
                holds.setdefault(part, []).append(hold)
            reasons.append("" if strong else "not_magnetic" if touched else "no_contact")
        return holds, tuple(reasons)
