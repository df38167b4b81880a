"""Vacuum cups: where a lip seals, and which load its vacuum carries.

Force is pressure times area. The limits of shear, torsion and bending are those of a thin elastic ring that the vacuum
presses on (Mahler et al., "Dex-Net 3.0", ICRA 2018, section IV; there linearised, here exact): the lip slips when
friction is exceeded, and lifts off on one side when the bending moment exceeds (F - N) r / 2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from pickproof.cell.config import Fine, Small
from pickproof.cell.frames import Array
from pickproof.cell.grippers.one_sided import TOUCH, OneSidedConfig, OneSidedGripper, Probe, Surface, disc, ring
from pickproof.cell.grippers.one_sided_hold import Hold

RIM_RAYS, INNER_RAYS = 24, 40
OUTSIDE = 0.0005  # [m] from the lip to the ring of rays around it

Seal = Literal["", "no_contact", "edge", "uneven", "tilted", "leaking"]


class VacuumConfig(OneSidedConfig):
    """Schema of a vacuum gripper's YAML file."""

    kind: Literal["vacuum"] = Field(description="cups")
    effective_diameter: Small = Field(description="[m] of the area under vacuum")
    pressure: float = Field(gt=0, le=101_325, description="[Pa] below atmospheric pressure")
    flatness: Fine = Field(0.001, gt=0, description="[m] peak-to-peak unevenness that the lip still seals")
    sprung_alone: bool = Field(
        False, description="each cup has its own spring: a cup above a lower place still touches, within the travel"
    )
    normal_deg: float = Field(15.0, gt=0, lt=90, description="largest angle of the surface normal to the cup's axis")

    def build(self) -> VacuumGripper:
        """The gripper."""
        return VacuumGripper(**self.fields())


@dataclass(frozen=True, kw_only=True)
class VacuumGripper(OneSidedGripper):
    """One cup or several; attributes are those of `VacuumConfig`."""

    effective_diameter: float
    pressure: float
    flatness: float
    normal_deg: float
    sprung_alone: bool = False

    @property
    def force(self) -> float:
        """Holding force of each sealed cup in [N]."""
        return float(self.pressure * np.pi * self.effective_diameter**2 / 4)

    def take(
        self, probe: Probe, magnetic: Callable[[int], bool], travel: float = 0.0
    ) -> tuple[dict[int, list[Hold]], tuple[str, ...]]:
        """The cups that seal, by workpiece; each has its own vacuum."""
        reach = TOUCH + (travel if self.sprung_alone else 0.0)
        holds: dict[int, list[Hold]] = {}
        seals: list[str] = []
        for centre in self.centres:
            around = ring(self.radius + OUTSIDE, RIM_RAYS)
            rim = probe(around + centre)
            inner = probe(disc(self.radius, INNER_RAYS) + centre)
            seals.append(self.seal(rim, inner, around, reach))
            if not seals[-1]:
                lever = self.radius / 2
                hold = Hold(centre, self.radius, self.force, self.friction, lever, self.radius)
                holds.setdefault(int(rim.part[0]), []).append(hold)
        return holds, tuple(seals)

    def seal(self, rim: Surface, inner: Surface, around: Array, reach: float = TOUCH) -> Seal:
        """Why a lip whose rim lies over points `around` (n, 2) does not seal; empty where it does.

        `reach` [m] is the largest distance between the plane of the faces and a surface that the lip touches.

        `leaking`: a ray within the lip misses the workpiece, as through a hole. A closed pocket is sealed by its rim.
        """
        if (rim.part < 0).all() or rim.gap.min() > reach:
            return "no_contact"
        if (rim.part != rim.part[0]).any():
            return "edge"
        plane = np.column_stack([around, np.ones(len(around))])
        off = rim.gap - plane @ np.linalg.lstsq(plane, rim.gap, rcond=None)[0]
        if np.ptp(off) > self.flatness:
            return "uneven"
        if rim.cosine.min() < np.cos(np.deg2rad(self.normal_deg)):
            return "tilted"
        return "leaking" if (inner.part != rim.part[0]).any() else ""
