"""Settings of the search and what they become for the shape of a workpiece."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pydantic import Field

from pickproof.cell.config import Config, Sigma
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.perception.refinement.config import VerifyConfig


class SearchConfig(Config):
    """Lengths in units, `Workpiece.unit`."""

    spacing: float = Field(0.10, gt=0, description="of the CAD samples that may lie at a seed")
    least_samples: int = Field(100, ge=1, description="CAD samples over the whole surface; less spacing where fewer")
    turns: int = Field(18, ge=4, description="turns about the normal; more where samples are denser or parts longer")
    turns_per_length: int = Field(16, ge=4, description="turns for each unit of a long part's length")
    most_turns: int = Field(64, ge=4, description="the same on the finest and longest shapes")
    voxel: float = Field(0.15, gt=0, description="one seed is taken in each voxel of this size")
    least_seeds: int = Field(450, ge=1, description="smaller voxels where a frame gives fewer seeds")
    most_poses: float = Field(4e6, gt=0, description="seeds x samples x turns; fewer seeds where a frame gives more")
    tolerance: float = Field(0.09, gt=0, description="depth within which a point agrees in the search")
    least_score: float = Field(0.12, description="mean score below which a pose is given up early")
    keep: int = Field(4, ge=1, description="best poses kept of each seed")
    apart: float = Field(0.12, ge=0, description="poses nearer than this before registration are one")
    most_coarse: int = Field(3000, ge=1, description="poses that go into coarse registration")
    vote_voxel: float = Field(0.09, gt=0, description="one point in each voxel of this size says which poses it is on")
    reach: float = Field(0.03, gt=0, description="distance of such a point from the surface of its pose")
    poses_per_point: int = Field(3, ge=1, description="best poses of a point that go into fine registration")
    claims_per_point: int = Field(2, ge=1, description="best poses of a point that go into the last one")
    least_ratio: float = Field(0.6, ge=0, le=1, description="inliers / (inliers + violations) after the rough look")
    verify: VerifyConfig = VerifyConfig(min_ratio=0.7)
    depth_sigma: Sigma | None = Field(None, description="[m] of a measured depth; none: what the frame says")


@dataclass(frozen=True)
class Density:
    """How densely one workpiece is searched.

    Attributes:
        spacing: of the CAD samples in units.
        turns: about the normal.
    """

    spacing: float
    turns: int

    @staticmethod
    def of(workpiece: Workpiece, config: SearchConfig) -> Density:
        """Thin and slender parts have little surface in their units, so they get denser samples and turns."""
        area = float(workpiece.mesh.area) / workpiece.unit**2
        spacing = min(config.spacing, math.sqrt(area / config.least_samples))
        length = float(workpiece.extents.max()) / workpiece.unit  # a turn moves the ends of a long part farther
        turns = round(max(config.turns * config.spacing / spacing, config.turns_per_length * length))
        return Density(spacing, min(turns, config.most_turns))
