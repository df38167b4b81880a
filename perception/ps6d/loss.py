"""The two losses of PS6D, the CAD-coordinate loss that is ours, and the losses of PPR-Net++ for its peer row."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

from pickproof.cell.symmetry.symmetry import Symmetry
from pickproof.perception.ps6d.network import Prediction


@dataclass(frozen=True)
class Target:
    """Ground truth of every voting point, for training and scoring only.

    Attributes:
        points: (m, 3) the voting points in units.
        centres: (m, 3) centre of the workpiece each point lies on.
        rotations: (m, 3, 3) R_camera_part of that workpiece.
        weights: (m,) the paper's C: distance to the centre normalised to [0.5, 1.5] within the instance.
    """

    points: Tensor
    centres: Tensor
    rotations: Tensor
    weights: Tensor


@dataclass(frozen=True)
class SymmetricModel:
    """What the rotation losses compare of the CAD.

    Attributes:
        points: (k, 3) CAD points in units, already multiplied by v.
        S: (s, 3, 3) the finite symmetry group.
        v: (3,)
        moment_root: (3, 3) symmetric root of the points' second moment, in units; with infinite symmetry
            sqrt(r^2 + z^2) on the axis, r^2 and z^2 the moments across and along it (Bregier et al. 2018, table 1).
    """

    points: Tensor
    S: Tensor
    v: Tensor
    moment_root: Tensor

    @staticmethod
    def of(points: Tensor, symmetry: Symmetry) -> SymmetricModel:
        """Of model points (m, 3) and the symmetry of their workpiece."""
        v = torch.tensor(symmetry.v.copy(), dtype=points.dtype)
        return SymmetricModel(
            points * v, torch.tensor(symmetry.S.copy(), dtype=points.dtype), v, _moment_root(points, v)
        )

    def to(self, device: torch.device) -> SymmetricModel:
        """The same on a device."""
        return SymmetricModel(*(x.to(device) for x in (self.points, self.S, self.v, self.moment_root)))


def _moment_root(points: Tensor, v: Tensor) -> Tensor:
    moment = points.T @ points / len(points)
    if v.sum() == 1:
        axis = v.bool()
        return torch.diag(v) * (moment[axis, axis] + moment.diagonal()[~axis].mean()).sqrt()
    values, axes = torch.linalg.eigh(moment)
    return v.prod() * (axes * values.clamp_min(0).sqrt()) @ axes.T


def rotation_loss(predicted: Tensor, true: Tensor, model: SymmetricModel) -> Tensor:
    """Symmetry-aware rotation loss per point (m,), in units (PS6D, eq. 2).

    min over s in S of the mean distance between R_gt s (M v) and R_pred (M v); M v are the CAD points with all but the
    axis of infinite symmetry removed.
    """
    ours = torch.einsum("mij,kj->mki", predicted, model.points)
    rotated = torch.einsum("sij,kj->ski", model.S, model.points)
    theirs = torch.einsum("mij,skj->mski", true, rotated)
    distance = (ours[:, None] - theirs).square().sum(-1).clamp_min(1e-12).sqrt().mean(-1)
    return distance.amin(dim=1)


def translation_loss(predicted: Tensor, true: Tensor, weights: Tensor) -> Tensor:
    """Centre-distance-sensitive translation loss per point (m,), in units (PS6D, eq. 3)."""
    return (predicted - true).square().sum(-1).clamp_min(1e-12).sqrt() * weights


def cad_loss(predicted: Tensor, target: Target, model: SymmetricModel) -> Tensor:
    """Distance (m,) of the predicted CAD coordinates to R^T (p - t), min over S; radius and height for an axis."""
    local = torch.einsum("mji,mj->mi", target.rotations, target.points - target.centres)
    if model.v.sum() == 1:  # about an infinite axis only the height and the radius can be known
        axis = model.v.bool()
        height = predicted[:, axis] - local[:, axis]
        radius = (predicted[:, ~axis].norm(dim=1) - local[:, ~axis].norm(dim=1))[:, None]
        return torch.cat([height, radius], dim=1).square().sum(-1).clamp_min(1e-12).sqrt()
    candidates = torch.einsum("sji,mj->msi", model.S, local)
    return (predicted[:, None] - candidates).square().sum(-1).clamp_min(1e-12).sqrt().amin(dim=1)


def centre_distance_weights(points: Tensor, centres: Tensor, instance: Tensor) -> Tensor:
    """C of eq. 3: distance to the centre, scaled within each instance so that the nearest is 0.5, the farthest 1.5."""
    d = (points - centres).norm(dim=1)
    n = int(instance.max()) + 1
    low = torch.full((n,), float("inf")).scatter_reduce(0, instance, d, "amin")[instance]
    high = torch.zeros(n).scatter_reduce(0, instance, d, "amax")[instance]
    return 0.5 + (d - low) / (high - low).clamp_min(1e-3)


def ps6d_loss(
    prediction: Prediction,
    target: Target,
    model: SymmetricModel,
    w_r: float = 1.0,
    w_t: float = 1.0,
    w_cad: float = 1.0,
) -> tuple[Tensor, dict[str, Tensor]]:
    """W_r L_r + W_t L_t (+ the CAD-coordinate loss when that head exists); the parts are returned for the curves."""
    rotation = rotation_loss(prediction.rotations, target.rotations, model).mean()
    translation = translation_loss(prediction.centres, target.centres, target.weights).mean()
    total = w_r * rotation + w_t * translation
    parts = {"rotation": rotation.detach(), "translation": translation.detach()}
    if prediction.cad is not None:
        cad = cad_loss(prediction.cad, target, model).mean()
        total = total + w_cad * cad
        parts["cad"] = cad.detach()
    return total, parts


PPR_NET_RIGHT = 0.05
"""[unit] a centre and a rotation are right at least this near; published: 5 mm, with a unit taken for 0.1 m."""
PPR_NET_CONFIDENCE_WEIGHT = 0.5
"""Of the confidence loss; published: 10 against 200 a metre of the two others."""


def ppr_net_loss(prediction: Prediction, target: Target, model: SymmetricModel) -> tuple[Tensor, dict[str, Tensor]]:
    """Losses of PPR-Net++ (Zeng et al. 2021) as its authors' code has them.

    Centre: sum of absolute differences. Rotation: least over the symmetries of the sum of absolute differences of
    R moment_root (Bregier's representation of a pose). Confidence: cross entropy against whether both are below half
    their mean, or below PPR_NET_RIGHT. Theirs are weighted by each instance's visibility; here all points weigh alike.
    """
    centre = (prediction.centres - target.centres).abs().sum(dim=1)
    true = torch.einsum("mij,sjk->msik", target.rotations, model.S @ model.moment_root)
    difference = (prediction.rotations @ model.moment_root)[:, None] - true
    rotation = difference.abs().sum(dim=(2, 3)).amin(dim=1)
    right = torch.ones_like(centre, dtype=torch.bool)
    for error in (centre.detach(), rotation.detach()):
        right &= error < (error.mean() / 2).clamp_min(PPR_NET_RIGHT)
    assert prediction.confidence is not None
    confidence = binary_cross_entropy_with_logits(prediction.confidence, right.to(centre.dtype))
    total = rotation.mean() + centre.mean() + PPR_NET_CONFIDENCE_WEIGHT * confidence
    parts = {"rotation": rotation.mean(), "translation": centre.mean(), "confidence": confidence}
    return total, {name: part.detach() for name, part in parts.items()}
