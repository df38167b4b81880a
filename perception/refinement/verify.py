"""Verification: does the depth image confirm a pose, and which of several claims on the same surface is right?

The camera saw every pixel through free space, so a pose that puts material where the camera looked through is
refuted; one whose surface was measured where it should be is confirmed; one behind an occluder is neither.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from pickproof.cell.config import Config
from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.ps6d.votes import Votes
from pickproof.perception.refinement.depth_agreement import compare, facing_camera
from pickproof.perception.refinement.depth_surface import SurfaceMap
from pickproof.perception.refinement.score_model import FEATURES

CENTRE_AGREES, ROTATION_AGREES = 0.2, 0.15
"""Distances in units within which a vote counts as for a pose."""

Floats = NDArray[np.float64]


class VerifyConfig(Config):
    """Thresholds of verification; lengths in units, `Workpiece.unit`."""

    tolerance: float = Field(0.005, ge=0, description="added to the sensor's share of the inlier distance")
    sigmas: float = Field(4.0, ge=0, description="the sensor's share, in standard deviations")
    min_ratio: float = Field(0.80, ge=0, le=1, description="least inliers / (inliers + violations)")
    min_visible: float = Field(0.15, ge=0, le=1, description="least confirmed share of the surface facing the camera")
    min_score: float | None = Field(None, ge=0, le=1, description="least score; none: the threshold of the score model")
    points: int = Field(384, ge=32, description="CAD points compared, for each unit of the part's length")
    max_shared: float = Field(0.35, ge=0, le=1, description="most of its surface owned by better poses")
    max_overlap: float = Field(0.05, ge=0, le=1, description="most of its surface deep inside a better pose")
    overlap_depth: float = Field(0.15, gt=0, description="what deep means, in thicknesses of the part")


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


@dataclass(frozen=True)
class Claims:
    """Examined poses: rotations (h, 3, 3), positions (h, 3) in units, evidence and calibrated score (h,)."""

    rotations: Tensor
    positions: Tensor
    evidence: Evidence
    scores: Floats

    def __len__(self) -> int:
        return len(self.scores)

    def select(self, index: np.ndarray) -> Claims:
        """The claims at `index`."""
        i = torch.from_numpy(index)
        return Claims(self.rotations[i], self.positions[i], self.evidence.select(index), self.scores[index])

    def join(self, other: Claims) -> Claims:
        """These claims, then others."""
        return Claims(
            torch.cat([self.rotations, other.rotations]),
            torch.cat([self.positions, other.positions]),
            self.evidence.join(other.evidence),
            np.concatenate([self.scores, other.scores]),
        )


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
    n_votes, centres_agree, rotations_agree = _support(R, t, shape, 2 * tolerance, votes)
    a = compare(R, t, scene, shape, shape.density * config.points // every)
    faces = facing_camera(R, t, a, shape)
    claimed = faces.sum(1).clamp(min=1).double()
    on = a.measured & (a.distance.abs() < tolerance) & faces
    turned = on & a.known_normal & (a.facing < 0.5)
    inlier = on & ~turned
    through = faces & ~on & (a.gap > tolerance)
    hidden = faces & ~on & (a.in_front > tolerance)
    band = compare(R, t, scene, shape, shape.density * config.points // (2 * every), halo=True)
    beside = band.measured & (band.distance > 2 * tolerance) & (band.distance < 0.05) & (band.in_front.abs() < 0.05)

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


def _support(
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


def settle(claims: Claims, scene: SurfaceMap, shape: ShapeModel, config: VerifyConfig) -> NDArray[np.int64]:
    """Indices of the claims that have no better rival, best first."""
    shared, overlap = rivalry(claims.rotations, claims.positions, scene, shape, config)
    return np.asarray(suppress(np.argsort(-claims.scores, kind="stable"), shared, overlap, config), dtype=np.int64)


def accepted(claims: Claims, standing: NDArray[np.int64], config: VerifyConfig, threshold: float) -> Claims:
    """Of the claims at the indices `standing`, (s,) from `settle`, those that pass every threshold.

    `threshold` is that of the score where the configuration has none.
    """
    good = claims.scores >= (config.min_score if config.min_score is not None else threshold)
    good &= (claims.evidence.ratio >= config.min_ratio) & (claims.evidence.inliers >= config.min_visible)
    return claims.select(standing[good[standing]])


def on_surface(
    points: np.ndarray, claims: Claims, scene: SurfaceMap, shape: ShapeModel, config: VerifyConfig
) -> np.ndarray:
    """Which camera points (m, 3), in units, lie on the surface of any claim (m,)."""
    p = torch.from_numpy(points.astype(np.float32))
    in_part = torch.matmul(p[None] - claims.positions[:, None], claims.rotations)
    on = shape.field.look_up(in_part)[0].abs() < 2 * inlier_tolerance(scene, config)
    return np.asarray(on.any(0).numpy())


def rivalry(
    R: Tensor, t: Tensor, scene: SurfaceMap, shape: ShapeModel, config: VerifyConfig, count: int = 160
) -> tuple[Floats, Floats]:
    """How claims conflict: shared (h, h) and overlap (h, h) of poses R (h, 3, 3), t (h, 3).

    shared[a, b]: share of the surface that confirms a and lies on b too. overlap[a, b]: share of the surface of a
    that is deep inside b.
    """
    h = len(R)
    shared, overlap = np.zeros((h, h)), np.zeros((h, h))
    tolerance = inlier_tolerance(scene, config)
    reach = 2 * float(np.linalg.norm(shape.points, axis=1).max())
    near = torch.cdist(t, t, compute_mode="donot_use_mm_for_euclid_dist") < reach
    near.fill_diagonal_(False)
    a, b = torch.nonzero(near, as_tuple=True)
    if len(a) == 0:
        return shared, overlap
    seen = compare(R, t, scene, shape, count)
    confirms = seen.measured & (seen.distance.abs() < tolerance)
    # of frame a into frame b
    R_ba = torch.bmm(R[b].transpose(1, 2), R[a])
    t_ba = torch.bmm(R[b].transpose(1, 2), (t[a] - t[b])[:, :, None]).transpose(1, 2)
    in_b = torch.bmm(seen.points[a], R_ba.transpose(1, 2)) + t_ba
    both = confirms[a] & (shape.field.look_up(in_b)[0].abs() < 1.5 * tolerance)
    shared[a, b] = (both.sum(1) / confirms[a].sum(1).clamp(min=1)).numpy()
    stride = max(1, len(shape.points) // count)
    surface = torch.from_numpy(shape.points[::stride].astype(np.float32))
    in_b = surface[None] @ R_ba.transpose(1, 2) + t_ba
    deep = shape.field.look_up(in_b)[0] < -config.overlap_depth * shape.thickness
    overlap[a, b] = deep.double().mean(1).numpy()
    return shared, overlap


def suppress(order: np.ndarray, shared: Floats, overlap: Floats, config: VerifyConfig) -> list[int]:
    """Go through poses from the best down; keep those that neither claim owned surface nor enter a kept one."""
    kept: list[int] = []
    for i in order:
        if kept:
            owned = shared[i, kept].sum()
            collides = max(overlap[i, kept].max(), overlap[kept, i].max())
            if owned > config.max_shared or collides > config.max_overlap:
                continue
        kept.append(int(i))
    return kept
