"""The two losses of PS6D, and the CAD-coordinate loss that is ours."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from cell.symmetry import Symmetry
from perception.network import Prediction


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
    """The CAD points that the rotation loss compares.

    Attributes:
        points: (k, 3) CAD points in units, already multiplied by v.
        S: (s, 3, 3) the finite symmetry group.
        v: (3,)
    """

    points: Tensor
    S: Tensor
    v: Tensor

    @staticmethod
    def of(points: Tensor, symmetry: Symmetry) -> SymmetricModel:
        v = torch.tensor(symmetry.v.copy(), dtype=points.dtype)
        return SymmetricModel(points * v, torch.tensor(symmetry.S.copy(), dtype=points.dtype), v)

    def to(self, device: torch.device) -> SymmetricModel:
        return SymmetricModel(self.points.to(device), self.S.to(device), self.v.to(device))


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
