"""What the depth image and the votes say for and against a pose.

Takes poses and the measured surface; gives `Evidence`. The camera saw every pixel through free space, so a pose that
puts material where the camera looked through is refuted; one whose surface was measured where it should be is
confirmed; one behind an occluder is neither. Poses are judged one by one: between poses on the same surface
`rivalry.py` decides.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.ps6d.votes import Votes
from pickproof.perception.refinement.config import VerifyConfig
from pickproof.perception.refinement.depth_agreement import compare, facing_camera
from pickproof.perception.refinement.depth_surface import SurfaceMap
from pickproof.perception.refinement.score_model import FEATURES

CENTRE_AGREES, ROTATION_AGREES = 0.2, 0.15
"""Distances in units within which a vote counts as for a pose."""
TURNED = 0.5
"""Least cosine of the measured normal and that of the CAD of a point that confirms a pose."""
BESIDE = 0.05
"""How far off the part, in units, a surface still continues it."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Evidence:
    """What the depth image says of h poses; all (h,).

    Attributes:
        inliers: points measured on the surface; violations: points where the camera saw through the part;
            occluded: hidden by something nearer; wrong_normal: measured on the surface but turned otherwise.
            As shares of the points that face the camera.
        ratio: inliers / (inliers + violations + wrong_normal).
        beside: share of the band around the outline where a surface continues just off the part.
        residual: root mean square distance of the inliers, in units.
        facing: mean cosine of the normals of inliers.
        area: of the inliers in the image, relative to the largest outline of the part.
        votes: number of voting points on the surface of the pose.
        centres_agree, rotations_agree: share of these that predicted its centre, and its rotation.
    """

    inliers: Floats
    violations: Floats
    occluded: Floats
    wrong_normal: Floats
    ratio: Floats
    beside: Floats
    residual: Floats
    facing: Floats
    area: Floats
    votes: Floats
    centres_agree: Floats
    rotations_agree: Floats

    def features(self, tolerance: float) -> Floats:
        """Inputs (h, len(FEATURES)) of the calibration, in the order of FEATURES."""
        columns = {
            "violations": self.violations / np.maximum(self.inliers + self.violations, 1e-6),
            "wrong_normal": self.wrong_normal / np.maximum(self.inliers + self.wrong_normal, 1e-6),
            "log_inliers": np.log(np.maximum(self.inliers, 1e-3)),
            "log_area": np.log(np.maximum(self.area, 1e-3)),
            "occluded": self.occluded,
            "beside": self.beside,
            "residual": self.residual / tolerance,
            "facing": 1.0 - self.facing,
            "log_votes": np.log1p(self.votes),
            "centres_agree": self.centres_agree,
            "rotations_agree": self.rotations_agree,
        }
        return np.stack([columns[name] for name in FEATURES], -1)

    def select(self, index: np.ndarray) -> Evidence:
        """The evidence of poses at `index`."""
        return Evidence(**{f.name: getattr(self, f.name)[index] for f in fields(self)})

    def join(self, other: Evidence) -> Evidence:
        """This evidence, then that of other poses."""
        pairs = {f.name: [getattr(self, f.name), getattr(other, f.name)] for f in fields(self)}
        return Evidence(**{name: np.concatenate(pair) for name, pair in pairs.items()})


def inlier_tolerance(scene: SurfaceMap, config: VerifyConfig) -> float:
    """Distance in units within which a measured point lies on the CAD."""
    return config.sigmas * scene.sigma + config.tolerance


def examine(
    R: Tensor,
    t: Tensor,
    scene: SurfaceMap,
    shape: ShapeModel,
    config: VerifyConfig,
    votes: Votes | None = None,
    every: int = 1,
) -> Evidence:
    """Compare poses R (h, 3, 3), t (h, 3) with the depth image, and with the votes on their surface.

    `every` = n takes one in n of the points: faster and rougher.
    """
    tolerance = inlier_tolerance(scene, config)
    n_votes, centres_agree, rotations_agree = vote_support(R, t, shape, 2 * tolerance, votes)
    a = compare(R, t, scene, shape, shape.density * config.points // every)
    faces = facing_camera(R, t, a, shape)
    claimed = faces.sum(1).clamp(min=1).double()
    on = a.measured & (a.distance.abs() < tolerance) & faces
    turned = on & a.known_normal & (a.facing < TURNED)
    inlier = on & ~turned
    through = faces & ~on & (a.gap > tolerance)
    hidden = faces & ~on & (a.in_front > tolerance)
    band = compare(R, t, scene, shape, shape.density * config.points // (2 * every), halo=True)
    beside = band.measured & (band.distance > 2 * tolerance) & (band.distance < BESIDE) & (band.in_front.abs() < BESIDE)

    def share(mask: Tensor) -> Floats:
        return np.asarray((mask.sum(1) / claimed).numpy())

    n_in = inlier.sum(1).double()
    known = inlier & a.known_normal
    square = torch.where(inlier, a.distance.square(), 0.0).double().sum(1) / n_in.clamp(min=1)
    cosine = torch.where(known, a.facing, 0.0).double().sum(1) / known.sum(1).clamp(min=1)
    view_area = shape.seen_area[shape.view_of(R, t)].double() / shape.seen_area.max()
    against = through.sum(1).double() + turned.sum(1).double()
    return Evidence(
        inliers=share(inlier),
        violations=share(through),
        occluded=share(hidden),
        wrong_normal=share(turned),
        ratio=np.asarray((n_in / (n_in + against).clamp(min=1)).numpy()),
        beside=np.asarray(beside.double().mean(1).numpy()),
        residual=np.asarray(square.sqrt().numpy()),
        facing=np.asarray(cosine.numpy()),
        area=np.asarray((n_in / claimed * view_area).numpy()),
        votes=n_votes,
        centres_agree=centres_agree,
        rotations_agree=rotations_agree,
    )


def vote_support(
    R: Tensor, t: Tensor, shape: ShapeModel, tolerance: float, votes: Votes | None
) -> tuple[Floats, Floats, Floats]:
    """Votes (h,) within `tolerance` of the surface of each pose, and the shares (h,) that predicted its centre and
    rotation to CENTRE_AGREES and ROTATION_AGREES."""
    h = len(R)
    if votes is None or len(votes) == 0:
        return np.zeros(h), np.zeros(h), np.zeros(h)
    points, centres = (torch.from_numpy(x.astype(np.float32)) for x in (votes.points, votes.centres))
    in_part = torch.matmul(points[None] - t[:, None], R)
    on = shape.field.look_up(in_part)[0].abs() < tolerance
    n = on.sum(1).double()
    near = torch.cdist(t, centres, compute_mode="donot_use_mm_for_euclid_dist") < CENTRE_AGREES
    predicted = torch.from_numpy(shape.embed(votes.rotations).astype(np.float32))
    turned = torch.zeros_like(near)
    for s in shape.symmetry.S:
        own = torch.from_numpy(shape.embed(R.double().numpy() @ s).astype(np.float32))
        turned |= torch.cdist(own, predicted, compute_mode="donot_use_mm_for_euclid_dist") < ROTATION_AGREES
    share = [np.asarray(((on & agrees).sum(1) / n.clamp(min=1)).numpy()) for agrees in (near, turned & near)]
    return np.asarray(n.numpy()), share[0], share[1]
