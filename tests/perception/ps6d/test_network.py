from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from pickproof.cell.frames import Array, random_rotations
from pickproof.perception.ps6d.layers import MaxOverNeighbours, NarrowLinear
from pickproof.perception.ps6d.network import NetworkConfig, Prediction, Ps6d, pack, quaternion_to_matrix
from pickproof.perception.ps6d.point_hierarchy import Graph
from pickproof.perception.training.dataset import train_sample
from tests.perception.small_heaps import bracket, small_heaps

pytestmark = pytest.mark.slow


@lru_cache(maxsize=1)
def graphs() -> list[Graph]:
    """Clouds of two small heaps."""
    return [train_sample(bracket(), small_heaps(), seed=0, index=i).graph for i in range(2)]


def network(config: NetworkConfig | None = None, trained: bool = True) -> Ps6d:
    """A network in evaluation mode whose BatchNorm statistics are not the initial ones."""
    torch.manual_seed(0)
    net = Ps6d(config or NetworkConfig())
    if trained:
        net.train()
        with torch.no_grad():
            for _ in range(3):
                net(pack(graphs()))
    return net.eval()


def turned(graph: Graph, R: Array) -> Graph:
    """The same cloud seen in other axes: every vector turns, every index stays."""
    Rf = R.astype(np.float32)
    levels = [replace(level, points=level.points @ Rf.T, frames=Rf @ level.frames) for level in graph.levels]
    return replace(
        graph,
        points=graph.points @ Rf.T,
        normals=graph.normals @ Rf.T,
        view=graph.view @ Rf.T,
        levels=(levels[0], levels[1], levels[2]),
    )


@torch.no_grad()
def predict(net: Ps6d, clouds: list[Graph]) -> Prediction:
    out: Prediction = net(pack(clouds))
    return out


def test_turning_the_scene_turns_the_prediction() -> None:
    net, cloud = network(), graphs()[0]
    plain = predict(net, [cloud])
    assert plain.cad is not None
    for R in random_rotations(4, np.random.default_rng(1)):
        other = predict(net, [turned(cloud, R)])
        assert other.cad is not None
        np.testing.assert_allclose(other.centres.numpy(), plain.centres.numpy() @ R.T, atol=1e-4)
        np.testing.assert_allclose(other.rotations.numpy(), R @ plain.rotations.numpy(), atol=1e-4)
        np.testing.assert_allclose(other.cad.numpy(), plain.cad.numpy(), atol=1e-4)
    assert plain.cad.std() > 1e-3  # the result is not a constant
    assert (plain.centres - torch.from_numpy(cloud.levels[0].points)).std() > 1e-3


def test_the_plain_network_is_not_equivariant() -> None:
    """What the local frames are for; this also shows that the test above can fail."""
    net, cloud = network(NetworkConfig(local_frames=False, cad_head=False)), graphs()[0]
    R = random_rotations(1, np.random.default_rng(1))[0]
    plain, other = predict(net, [cloud]), predict(net, [turned(cloud, R)])
    assert np.abs(other.rotations.numpy() - R @ plain.rotations.numpy()).max() > 0.01


def test_moving_the_scene_moves_the_prediction() -> None:
    net, cloud = network(), graphs()[0]
    shift = np.array([0.3, -1.0, 2.0], np.float32)
    levels = [replace(level, points=level.points + shift) for level in cloud.levels]
    moved = replace(cloud, points=cloud.points + shift, levels=(levels[0], levels[1], levels[2]))
    plain, other = predict(net, [cloud]), predict(net, [moved])
    np.testing.assert_allclose(other.centres.numpy(), plain.centres.numpy() + shift, atol=1e-4)
    np.testing.assert_allclose(other.rotations.numpy(), plain.rotations.numpy(), atol=1e-4)


@pytest.mark.parametrize("config", [NetworkConfig(), NetworkConfig(local_frames=False, cad_head=False)])
def test_clouds_of_a_batch_do_not_see_each_other(config: NetworkConfig) -> None:
    net = network(config)
    packed = pack(graphs())
    alone = [predict(net, [g]) for g in graphs()]
    together = predict(net, graphs())
    assert packed.sizes == tuple(len(a.centres) for a in alone)
    for name in ("centres", "rotations") + (("cad",) if config.cad_head else ()):
        expected = np.concatenate([getattr(a, name).numpy() for a in alone])
        np.testing.assert_allclose(getattr(together, name).numpy(), expected, atol=1e-5)


def test_packing_shifts_indices_to_the_same_points() -> None:
    packed, (a, b) = pack(graphs()), graphs()
    n0, n1 = len(a.points), len(a.levels[0].points)
    np.testing.assert_array_equal(packed.levels[0].down[n1:].numpy() - n0, b.levels[0].down)
    np.testing.assert_array_equal(packed.levels[1].up[n1:].numpy() - len(a.levels[1].points), b.levels[1].up)
    np.testing.assert_array_equal(packed.points[n0:].numpy(), b.points)


@pytest.mark.parametrize("config", [NetworkConfig(), NetworkConfig(local_frames=False, cad_head=False)])
def test_a_prediction_is_one_rotation_and_one_centre_for_every_voting_point(config: NetworkConfig) -> None:
    out = predict(network(config), graphs())
    m = sum(len(g.levels[0].points) for g in graphs())
    assert out.centres.shape == (m, 3)
    assert out.rotations.shape == (m, 3, 3)
    assert (out.cad is None) == (not config.cad_head)
    eye = out.rotations.transpose(1, 2) @ out.rotations
    np.testing.assert_allclose(eye.numpy(), np.tile(np.eye(3), (m, 1, 1)), atol=1e-5)
    np.testing.assert_allclose(torch.linalg.det(out.rotations).numpy(), 1, atol=1e-5)


def test_every_parameter_learns() -> None:
    torch.manual_seed(0)
    net = Ps6d()
    out = net(pack(graphs()))
    assert out.cad is not None
    (out.centres.square().sum() + (out.rotations * torch.randn(3, 3)).sum() + out.cad.square().sum()).backward()
    dead = [name for name, p in net.named_parameters() if p.grad is None or not p.grad.abs().max() > 0]
    assert dead == []


def test_attention_by_terms_is_that_of_their_sum() -> None:
    """The published order: weights(k_j - q_i + delta), then softmax (Point Transformer, eq. 3)."""
    torch.manual_seed(0)
    block, cloud = Ps6d().block2.double(), graphs()[0]
    index = torch.from_numpy(cloud.levels[1].block)
    y, hidden = torch.randn(len(index), 96).double(), torch.randn(*index.shape, 48).double()
    delta = block.position.second(hidden)
    expected = torch.softmax(block.weights(block.k(y)[index] - block.q(y)[:, None] + delta), dim=1)
    assert expected.std() > 1e-3
    torch.testing.assert_close(block._attention(y, hidden, index), expected, rtol=0, atol=1e-12)


def test_gradients_written_by_hand_are_those_of_autograd() -> None:
    x = torch.randn(50, 6, 5, dtype=torch.float64, requires_grad=True)
    layer = NarrowLinear(5, 7).double()
    upstream = torch.randn(50, 7).double()
    (MaxOverNeighbours.apply(layer(x)) * upstream).sum().backward()
    by_hand = [x.grad, layer.weight.grad, layer.bias.grad]
    x.grad = layer.weight.grad = layer.bias.grad = None
    (torch.nn.functional.linear(x, layer.weight, layer.bias).amax(dim=1) * upstream).sum().backward()
    for mine, theirs in zip(by_hand, [x.grad, layer.weight.grad, layer.bias.grad], strict=True):
        torch.testing.assert_close(mine, theirs, rtol=0, atol=1e-12)


def test_quaternions_become_the_rotations_of_scipy() -> None:
    quat_xyzw = np.random.default_rng(3).standard_normal((200, 4))  # of any length
    out = quaternion_to_matrix(torch.from_numpy(quat_xyzw)).numpy()
    np.testing.assert_allclose(out, Rotation.from_quat(quat_xyzw).as_matrix(), atol=1e-12)


def test_a_quaternion_of_zero_is_finite() -> None:
    assert torch.isfinite(quaternion_to_matrix(torch.zeros(1, 4))).all()
