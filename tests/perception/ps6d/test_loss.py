from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from pickproof.cell.frames import about_axis, random_rotations
from pickproof.cell.symmetry.symmetry import Symmetry
from pickproof.perception.ps6d.loss import (
    SymmetricModel,
    Target,
    cad_loss,
    centre_distance_weights,
    ps6d_loss,
    rotation_loss,
    translation_loss,
)
from pickproof.perception.ps6d.network import Prediction

NONE, TWOFOLD, FOURFOLD = Symmetry(), Symmetry((0, 0, 180)), Symmetry((0, 90, 0))
DIHEDRAL, AXIS, SPINDLE = Symmetry((180, 180, 180)), Symmetry((0, 0, 1)), Symmetry((180, 0, 1))
SPHERE = Symmetry((1, 1, 0))
ALL = [NONE, TWOFOLD, FOURFOLD, DIHEDRAL, AXIS, SPINDLE, SPHERE]
FLOOR = 2e-6
"""Distances are clamped at 1e-6, so that their gradient exists at zero."""


def rotations(n: int, seed: int = 0) -> Tensor:
    return torch.from_numpy(random_rotations(n, np.random.default_rng(seed)))


def model(symmetry: Symmetry, k: int = 12) -> SymmetricModel:
    points = np.random.default_rng(9).uniform(-0.5, 0.5, (k, 3))
    return SymmetricModel.of(torch.from_numpy(points), symmetry)


def target(m: int = 20, seed: int = 1) -> Target:
    rng = np.random.default_rng(seed)
    points, centres = torch.from_numpy(rng.standard_normal((2, m, 3)))
    return Target(points, centres, rotations(m, seed), torch.ones(m, dtype=torch.float64))


def true_cad(t: Target) -> Tensor:
    return torch.einsum("mji,mj->mi", t.rotations, t.points - t.centres)


@pytest.mark.parametrize("symmetry", ALL, ids=lambda s: str(s.degrees))
def test_the_truth_costs_nothing(symmetry: Symmetry) -> None:
    t = target()
    loss, parts = ps6d_loss(Prediction(t.centres, t.rotations, true_cad(t)), t, model(symmetry))
    assert set(parts) == {"rotation", "translation", "cad"}
    assert all(0 <= float(part) < FLOOR for part in parts.values())
    assert float(loss) < 3 * FLOOR


@pytest.mark.parametrize("symmetry", [TWOFOLD, FOURFOLD, DIHEDRAL], ids=lambda s: str(s.degrees))
def test_poses_that_look_alike_cost_the_same(symmetry: Symmetry) -> None:
    t, other, m = target(), rotations(20, seed=5), model(symmetry)
    plain = rotation_loss(other, t.rotations, m)
    assert plain.min() > 0.01
    for S in torch.from_numpy(symmetry.S.copy()):
        np.testing.assert_allclose(rotation_loss(other, t.rotations @ S, m), plain, atol=1e-12)
        assert rotation_loss(t.rotations @ S, t.rotations, m).max() < FLOOR
        local = true_cad(t) @ S.T  # what a network says that takes the part for turned
        assert cad_loss(local, t, m).max() < FLOOR


@pytest.mark.parametrize(("symmetry", "axis"), [(AXIS, 2), (SPINDLE, 2), (Symmetry((1, 0, 0)), 0)])
def test_any_turn_about_an_infinite_axis_is_free(symmetry: Symmetry, axis: int) -> None:
    t, m = target(), model(symmetry)
    angles = np.random.default_rng(2).uniform(-np.pi, np.pi, 20)
    turn = torch.from_numpy(about_axis(np.eye(3)[axis], angles)[:, :3, :3])
    assert rotation_loss(t.rotations @ turn, t.rotations, m).max() < FLOOR
    np.testing.assert_allclose(
        rotation_loss(rotations(20, 7) @ turn, t.rotations, m),
        rotation_loss(rotations(20, 7), t.rotations, m),
        atol=1e-9,
    )
    around = torch.einsum("mij,mj->mi", turn, true_cad(t))
    assert cad_loss(around, t, m).max() < FLOOR


def test_a_turn_across_the_axis_is_not_free() -> None:
    t, m = target(), model(AXIS)
    tilt = torch.from_numpy(about_axis((1, 0, 0), np.array(0.3))[:3, :3])
    assert rotation_loss(t.rotations @ tilt, t.rotations, m).min() > 0.01
    upside_down = torch.from_numpy(about_axis((1, 0, 0), np.array(np.pi))[:3, :3])
    assert rotation_loss(t.rotations @ upside_down, t.rotations, m).min() > 0.1
    assert rotation_loss(t.rotations @ upside_down, t.rotations, model(SPINDLE)).max() < FLOOR


def test_without_symmetry_only_the_truth_is_free() -> None:
    t = target()
    half_turn = torch.from_numpy(about_axis((0, 0, 1), np.array(np.pi))[:3, :3])
    assert rotation_loss(t.rotations @ half_turn, t.rotations, model(NONE)).min() > 0.1
    assert rotation_loss(t.rotations @ half_turn, t.rotations, model(TWOFOLD)).max() < FLOOR


def test_a_spheres_rotation_costs_nothing() -> None:
    assert rotation_loss(rotations(20, 3), rotations(20, 4), model(SPHERE)).max() < FLOOR


def test_rotation_loss_by_hand() -> None:
    """One CAD point at distance 2 of the axis, turned by 90 degrees: the chord 2 sqrt(2)."""
    one = SymmetricModel.of(torch.tensor([[2.0, 0.0, 5.0]]), NONE)
    quarter = torch.from_numpy(about_axis((0, 0, 1), np.array([np.pi / 2]))[:, :3, :3]).float()
    assert float(rotation_loss(quarter, torch.eye(3)[None], one)) == pytest.approx(2 * np.sqrt(2), rel=1e-6)


def test_rotation_loss_is_the_least_mean_over_the_group() -> None:
    m, a, b = model(DIHEDRAL), rotations(6, 1), rotations(6, 2)
    expected = [
        min(
            np.linalg.norm(m.points.numpy() @ (R.numpy().T) - (m.points.numpy() @ S.T) @ T.numpy().T, axis=1).mean()
            for S in DIHEDRAL.S
        )
        for R, T in zip(a, b, strict=True)
    ]
    np.testing.assert_allclose(rotation_loss(a, b, m), expected, atol=1e-12)


def test_translation_loss_by_hand() -> None:
    """3-4-5 triangles, weighted by 0.5 and 1.5."""
    predicted = torch.tensor([[3.0, 4.0, 0.0], [1.0, 1.0, 6.0]])
    true = torch.tensor([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
    out = translation_loss(predicted, true, torch.tensor([0.5, 1.5]))
    np.testing.assert_allclose(out, [2.5, 7.5], rtol=1e-6)


def test_weights_run_from_half_to_one_and_a_half_within_each_instance() -> None:
    rng = np.random.default_rng(3)
    instance = torch.from_numpy(rng.permutation(np.repeat([0, 1, 3], 30)))  # 2 is not seen
    points, centres = torch.from_numpy(rng.standard_normal((2, 90, 3))).float()
    C = centre_distance_weights(points, centres, instance)
    d = (points - centres).norm(dim=1)
    for i in (0, 1, 3):
        mine = instance == i
        assert float(C[mine].min()) == 0.5
        assert float(C[mine].max()) == pytest.approx(1.5)
        assert torch.equal(C[mine].argsort(), d[mine].argsort())
        np.testing.assert_allclose(
            C[mine], 0.5 + (d[mine] - d[mine].min()) / (d[mine].max() - d[mine].min()), atol=1e-6
        )


def test_a_lone_point_has_a_finite_weight() -> None:
    C = centre_distance_weights(torch.ones(1, 3), torch.zeros(1, 3), torch.zeros(1, dtype=torch.long))
    assert float(C) == 0.5


@pytest.mark.parametrize("symmetry", [NONE, FOURFOLD, AXIS], ids=lambda s: str(s.degrees))
def test_gradients_are_those_of_finite_differences(symmetry: Symmetry) -> None:
    m = model(symmetry, k=5)
    t = replace(target(4), weights=torch.tensor([0.5, 0.9, 1.2, 1.5], dtype=torch.float64))
    rng = np.random.default_rng(4)
    centres, cad = (torch.from_numpy(rng.standard_normal((4, 3))).requires_grad_() for _ in range(2))
    matrices = rotations(4, 8).requires_grad_()

    def loss(c: Tensor, R: Tensor, x: Tensor) -> Tensor:
        return ps6d_loss(Prediction(c, R, x), t, m, w_r=0.7, w_t=1.3, w_cad=0.4)[0]

    assert torch.autograd.gradcheck(loss, (centres, matrices, cad), eps=1e-6, atol=1e-6)


def test_gradients_are_finite_at_the_truth() -> None:
    t = target()
    inputs = [x.clone().requires_grad_() for x in (t.centres, t.rotations, true_cad(t))]
    for m in (model(NONE), model(AXIS), model(SPHERE)):
        loss, _ = ps6d_loss(Prediction(*inputs), t, m)
        for gradient in torch.autograd.grad(loss, inputs, allow_unused=True):
            assert gradient is None or torch.isfinite(gradient).all()


def test_weights_of_the_parts_and_a_network_without_cad_head() -> None:
    t, m = target(), model(NONE)
    prediction = Prediction(t.centres + 1, rotations(20, 6), true_cad(t) + 1)
    total, parts = ps6d_loss(prediction, t, m, w_r=2, w_t=3, w_cad=5)
    assert float(total) == pytest.approx(2 * parts["rotation"] + 3 * parts["translation"] + 5 * parts["cad"])
    assert float(parts["translation"]) == pytest.approx(np.sqrt(3))
    plain, fewer = ps6d_loss(replace(prediction, cad=None), t, m)
    assert set(fewer) == {"rotation", "translation"}
    assert float(plain) == pytest.approx(float(parts["rotation"] + parts["translation"]))
