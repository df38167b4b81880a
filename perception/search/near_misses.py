"""Measurements that lie close to a claimed surface without lying on it.

Verification takes a measurement in front of the claimed surface for an occluder. An occluder is a workpiece and has
its thickness; what lies in front by a fraction of that is more likely the same workpiece in another pose, as upside
down or turned by nearly a symmetry.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from pickproof.cell.frames import Array
from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.refinement.depth_agreement import compare, facing_camera
from pickproof.perception.refinement.depth_surface import SurfaceMap
from pickproof.perception.search.poses import Poses

POINTS = 192
SHALLOW = 0.4
"""Thicknesses of the part up to which a measurement in front is near."""
SIGMAS, LEAST_SCALE = 2.5, 0.001
"""Distance [standard deviations], [units] that counts as one; twice of it is as bad as can be."""


@dataclass(frozen=True)
class NearMisses:
    """Of h poses.

    Attributes:
        shallow: (h,) share of the surface facing the camera with a measurement closely in front of it.
        misfit: (h,) mean squared distance of what was measured near the surface, cut at its worst, in [0, 1].
    """

    shallow: Array
    misfit: Array

    @staticmethod
    def of(poses: Poses, surface: SurfaceMap, shape: ShapeModel, tolerance: float) -> NearMisses:
        """Of poses in a depth image; `tolerance` in units is that of an inlier."""
        R, t = poses.rotations, poses.positions
        a = compare(R, t, surface, shape, POINTS)
        faces = facing_camera(R, t, a, shape)
        on = a.distance.abs() < tolerance
        front = faces & a.measured & (a.in_front > tolerance) & ~on
        shallow = front & (a.in_front < SHALLOW * shape.thickness)
        through = faces & (a.gap > tolerance) & ~on
        used = (faces & a.measured & ~front) | shallow | through
        scale = SIGMAS * surface.sigma + LEAST_SCALE
        cost = (a.distance / scale).square().clamp(max=4.0) / 4.0
        cost = torch.where(through | (a.known_normal & (a.facing < 0.5)), 1.0, cost)
        n = faces.sum(1).clamp(min=1).double()
        misfit = (cost.double() * used).sum(1) / used.sum(1).clamp(min=1)
        return NearMisses(np.asarray((shallow.sum(1) / n).numpy()), np.asarray(misfit.numpy()))
