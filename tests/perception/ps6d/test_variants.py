"""Every variant of the paper's tables, and the clustering of PPR-Net."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from pickproof.cell.errors import InputError
from pickproof.cell.frames import about_axis, random_rotations
from pickproof.cell.symmetry.symmetry import Symmetry
from pickproof.perception.ps6d.loss import SymmetricModel, ppr_net_loss
from pickproof.perception.ps6d.network import NetworkConfig, Prediction, Ps6d, euler_to_matrix, pack
from pickproof.perception.ps6d.ppr_net import PPR_NET_BANDWIDTH, ppr_net, ppr_net_pp
from pickproof.perception.ps6d.variants import FIXED_UNIT, VARIANTS, cluster_config, network_config, variant_of
from pickproof.perception.ps6d.votes import Votes
from pickproof.perception.ps6d.voting import ClusterConfig
from pickproof.perception.ps6d.weights import load_weights, save_weights
from tests.perception.ps6d.test_loss import rotations, target
from tests.perception.ps6d.test_network import graphs, network, predict, turned
from tests.perception.small_heaps import bracket

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_variant_predicts_a_pose_for_every_voting_point(variant: str) -> None:
    config = network_config(variant, bracket())
    out = predict(network(config), graphs())
    m = sum(len(g.levels[0].points) for g in graphs())
    assert out.centres.shape == (m, 3)
    np.testing.assert_allclose(out.rotations @ out.rotations.mT, np.tile(np.eye(3), (m, 1, 1)), atol=1e-5)
    np.testing.assert_allclose(torch.linalg.det(out.rotations), 1, atol=1e-5)
    assert (out.cad is not None) == (variant not in ("plain", "no_cad_head", "ppr_net_pp"))
    assert (out.confidence is not None) == (variant == "ppr_net_pp")


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_parameter_of_every_variant_learns(variant: str) -> None:
    torch.manual_seed(0)
    net = Ps6d(network_config(variant, bracket()))
    out = net(pack(graphs()))
    total = out.centres.square().sum() + (out.rotations * torch.randn(3, 3)).sum()
    for extra in (out.cad, out.confidence):
        total = total + (0 if extra is None else extra.square().sum())
    total.backward()
    assert [name for name, p in net.named_parameters() if p.grad is None or not p.grad.abs().max() > 0] == []


@pytest.mark.parametrize("variant", VARIANTS)
def test_equivariance_is_the_gift_of_local_frames(variant: str) -> None:
    config = network_config(variant, bracket())
    net, cloud = network(config), graphs()[0]
    R = random_rotations(1, np.random.default_rng(1))[0]
    here, there = predict(net, [cloud]), predict(net, [turned(cloud, R)])
    error = np.abs(there.rotations.numpy() - R @ here.rotations.numpy()).max()
    assert error < 1e-4 if config.local_frames else error > 0.01


@pytest.mark.parametrize("variant", VARIANTS)
def test_clouds_of_a_batch_do_not_see_each_other(variant: str) -> None:
    net = network(network_config(variant, bracket()))
    alone = np.concatenate([predict(net, [g]).centres for g in graphs()])
    np.testing.assert_allclose(predict(net, graphs()).centres, alone, atol=1e-5)


@pytest.mark.parametrize("variant", VARIANTS)
def test_weights_bring_their_variant_back(variant: str, tmp_path: Path) -> None:
    config = replace(network_config(variant, bracket()), channels=(8, 12, 16), features=16)
    torch.manual_seed(0)
    save_weights(tmp_path / "w.safetensors", Ps6d(config), bracket(), {})
    back = load_weights(tmp_path / "w.safetensors", bracket())
    assert back.config == config
    assert variant_of(back.config) == variant
    again = predict(back, graphs())
    np.testing.assert_array_equal(
        predict(load_weights(tmp_path / "w.safetensors", None), graphs()).centres, again.centres
    )


def test_a_network_of_no_variant_is_custom() -> None:
    assert variant_of(NetworkConfig(backbone="pointnet2_msg", local_frames=False)) == "custom"
    with pytest.raises(InputError, match="pointnet2_msg"):
        network_config("pointnet", bracket())


def test_without_normalisation_the_size_of_a_workpiece_matters() -> None:
    """With one unit of 0.1 m it changes nothing; else the same weights see and say other lengths."""
    cloud = graphs()[0]
    normal = network(trained=False)
    outputs = []
    for scale in (1.0, bracket().unit / FIXED_UNIT):
        net = Ps6d(NetworkConfig(coordinate_scale=scale)).eval()
        net.load_state_dict(normal.state_dict())
        outputs.append(predict(net, [cloud]))
    points, same = torch.from_numpy(cloud.levels[0].points), predict(normal, [cloud])
    np.testing.assert_array_equal(outputs[0].centres, same.centres)
    assert (outputs[1].centres - points).std() / (same.centres - points).std() > 1.2
    assert (outputs[1].rotations - same.rotations).abs().max() > 1e-3


def test_without_normalisation_a_scaled_cloud_in_a_scaled_unit_is_the_same_to_the_network() -> None:
    """What enters and leaves is in 0.1 m: only neighbours and voxels still follow the unit."""
    cloud = graphs()[0]
    levels = [replace(level, points=level.points / 2) for level in cloud.levels]
    half = replace(cloud, points=cloud.points / 2, levels=(levels[0], levels[1], levels[2]))
    one = network(NetworkConfig(coordinate_scale=0.56), trained=False)
    double = Ps6d(NetworkConfig(coordinate_scale=1.12)).eval()
    double.load_state_dict(one.state_dict())
    a, b = predict(one, [cloud]), predict(double, [half])
    np.testing.assert_allclose(b.centres * 2, a.centres, atol=1e-5)
    np.testing.assert_allclose(b.rotations, a.rotations, atol=1e-5)


def test_without_normalisation_bandwidths_are_fixed_lengths() -> None:
    base = ClusterConfig()
    config = network_config("no_normalisation", bracket())
    fixed = cluster_config(config, base)
    for name in ("position_bandwidth", "rotation_bandwidth", "merge_bandwidth"):
        assert getattr(fixed, name) * bracket().unit == pytest.approx(getattr(base, name) * FIXED_UNIT)
    assert cluster_config(NetworkConfig(), base) == base


def test_euler_angles_become_the_rotations_of_scipy() -> None:
    rpy = np.random.default_rng(3).uniform(-4, 4, (100, 3))
    expected = Rotation.from_euler("xyz", rpy).as_matrix()
    np.testing.assert_allclose(euler_to_matrix(torch.from_numpy(rpy)), expected, atol=1e-12)


def box_model(symmetry: Symmetry) -> SymmetricModel:
    corners = np.array(np.meshgrid([-1, 1], [-2, 2], [-3, 3])).reshape(3, -1).T / 10
    return SymmetricModel.of(torch.from_numpy(corners), symmetry)


def test_the_moment_of_a_box_by_hand() -> None:
    np.testing.assert_allclose(box_model(Symmetry()).moment_root, np.diag([0.1, 0.2, 0.3]), atol=1e-12)
    axis = box_model(Symmetry((0, 0, 1))).moment_root
    np.testing.assert_allclose(axis, np.diag([0, 0, np.sqrt(0.3**2 + (0.1**2 + 0.2**2) / 2)]), atol=1e-12)
    assert not box_model(Symmetry((1, 1, 0))).moment_root.any()


def confident(t_centres: torch.Tensor, t_rotations: torch.Tensor, odds: float) -> Prediction:
    return Prediction(t_centres, t_rotations, None, torch.full((len(t_centres),), odds, dtype=torch.float64))


def test_ppr_net_loss_by_hand() -> None:
    """Centres off by (0.1, -0.2, 0.3); a quarter turn about z moves moments 0.1 and 0.2 by their sum, twice."""
    t, model = target(), box_model(Symmetry())
    t = replace(t, rotations=torch.eye(3, dtype=torch.float64).expand(20, 3, 3))
    quarter = torch.from_numpy(about_axis((0, 0, 1), np.array(np.pi / 2))[:3, :3]).expand(20, 3, 3)
    prediction = confident(t.centres + torch.tensor([0.1, -0.2, 0.3]), quarter, -2.0)
    total, parts = ppr_net_loss(prediction, t, model)
    assert float(parts["translation"]) == pytest.approx(0.6)
    assert float(parts["rotation"]) == pytest.approx(0.6)
    assert float(parts["confidence"]) == pytest.approx(np.log1p(np.exp(-2.0)))  # none is right: -log(1 - p)
    assert float(total) == pytest.approx(1.2 + 0.5 * np.log1p(np.exp(-2.0)))
    _, right = ppr_net_loss(confident(t.centres, t.rotations, 2.0), t, model)
    assert float(right["confidence"]) == pytest.approx(np.log1p(np.exp(-2.0)))
    assert float(right["rotation"]) < 1e-12


@pytest.mark.parametrize("symmetry", [Symmetry((0, 0, 180)), Symmetry((180, 180, 180)), Symmetry((180, 0, 1))])
def test_ppr_net_loss_is_blind_to_symmetry(symmetry: Symmetry) -> None:
    t, model = target(), box_model(symmetry)
    _, plain = ppr_net_loss(confident(t.centres, rotations(20, 5), 0.0), t, model)
    assert plain["rotation"] > 0.05
    for S in torch.from_numpy(symmetry.rotations(5).copy()):
        _, other = ppr_net_loss(confident(t.centres, rotations(20, 5) @ S, 0.0), t, model)
        if not symmetry.infinite_axis:  # absolute differences of turned moments; exact for flips of the axes
            assert float(other["rotation"]) == pytest.approx(float(plain["rotation"]))
        _, same = ppr_net_loss(confident(t.centres, t.rotations @ S, 0.0), t, model)
        assert same["rotation"] < 1e-9


def heap_of_votes(rng: np.random.Generator, unit: float = 0.2) -> tuple[Votes, np.ndarray, np.ndarray]:
    """Three instances of 200 votes each, 5 units apart, with 3 mm and 3 degrees of noise; rotations; positions [m]."""
    R = random_rotations(3, rng)
    t = np.arange(3)[:, None] * np.array([5.0, 0, 0]) + rng.standard_normal((3, 3)) * 0.1
    of = np.repeat(np.arange(3), 200)
    noise = Rotation.from_rotvec(rng.standard_normal((600, 3)) * np.deg2rad(3)).as_matrix()
    centres = t[of] + rng.standard_normal((600, 3)) * 0.003 / unit / np.sqrt(3)
    return Votes(centres + rng.uniform(-0.4, 0.4, (600, 3)), centres, R[of] @ noise), R, t * unit


def test_ppr_net_averages_the_votes_of_each_centre() -> None:
    votes, R, t = heap_of_votes(np.random.default_rng(0))
    for poses in (ppr_net(votes, 0.2), ppr_net_pp(votes, np.full(600, 0.9), 0.2)):
        assert len(poses) == 3
        for pose in poses:
            i = int(np.linalg.norm(t - pose.T_camera_part[:3, 3], axis=1).argmin())
            assert np.linalg.norm(t[i] - pose.T_camera_part[:3, 3]) < 1e-3
            assert Rotation.from_matrix(R[i].T @ pose.T_camera_part[:3, :3]).magnitude() < np.deg2rad(1)
            assert pose.n_votes > 190
    assert sum(p.score for p in poses) == pytest.approx(0.9 * sum(p.n_votes for p in poses) / 600)


def test_ppr_net_averages_symmetric_votes_to_neither() -> None:
    """What the paper blames single-stage clustering for: half the votes turned by 180 degrees."""
    votes, R, _ = heap_of_votes(np.random.default_rng(1))
    half_turn = about_axis((0, 0, 1), np.array(np.pi))[:3, :3]
    votes.rotations[::2] = votes.rotations[::2] @ half_turn
    for pose in ppr_net(votes, 0.2):
        errors = [Rotation.from_matrix(r.T @ pose.T_camera_part[:3, :3]).magnitude() for r in [*R, *(R @ half_turn)]]
        assert min(errors) > np.deg2rad(20)


def test_only_confident_points_vote_in_ppr_net_pp() -> None:
    votes, R, t = heap_of_votes(np.random.default_rng(2))
    wrong = np.arange(600) % 2 == 0
    votes.rotations[wrong] = random_rotations(300, np.random.default_rng(3))
    poses = ppr_net_pp(votes, np.where(wrong, 0.4, 0.8), 0.2)
    assert sorted(p.n_votes for p in poses) == [100, 100, 100]
    for pose in poses:
        i = int(np.linalg.norm(t - pose.T_camera_part[:3, 3], axis=1).argmin())
        assert Rotation.from_matrix(R[i].T @ pose.T_camera_part[:3, :3]).magnitude() < np.deg2rad(1)
    assert ppr_net_pp(votes, np.zeros(600), 0.2) == []


def test_ppr_nets_bandwidth_is_a_length_and_that_of_the_other_follows_the_workpiece() -> None:
    rng = np.random.default_rng(4)
    spread = 2.2 * PPR_NET_BANDWIDTH  # [m] between two groups of votes
    for unit in (0.05, 0.5):
        centres = np.repeat([[0.0, 0, 0], [spread / unit, 0, 0]], 100, axis=0) + rng.standard_normal((200, 3)) * 1e-3
        votes = Votes(centres, centres, np.tile(np.eye(3), (200, 1, 1)))
        assert len(ppr_net(votes, unit)) == 2
        assert len(ppr_net_pp(votes, np.ones(200), unit)) == (2 if unit == 0.05 else 1)
