"""Registration: the field is the distance, its Jacobian the derivative, and poses come back after a push."""

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

from pickproof.cell.frames import rotation_angle
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.perception.cad.distance_field import DistanceField
from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.refinement.depth_agreement import compare, soft_score
from pickproof.perception.refinement.depth_surface import SurfaceMap
from pickproof.perception.refinement.icp import COARSE, FINE, LAST, MIN_FACING, _exp, register
from pickproof.perception.refinement.normal_equations import (
    Association,
    CadPoints,
    EdgeSearch,
    Outline,
    VoteWeights,
    rim_terms,
    surface_terms,
)
from pickproof.perception.refinement.numba_kernels import KernelPoses
from tests.perception import artificial

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scene():
    return artificial.heap()


def test_field_of_a_box_is_the_analytic_distance():
    half = np.array([0.5, 0.3, 0.2])
    field = DistanceField.of(trimesh.creation.box(2 * half))
    p = np.random.default_rng(0).uniform(-1, 1, (3000, 3)) * (half + 0.08)
    q = np.abs(p) - half
    exact = np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(1), 0)
    found = field.look_up(torch.from_numpy(p.astype(np.float32)))[0].numpy()
    error = np.abs(found - exact)
    assert np.median(error[np.abs(exact) < 0.02]) < 1e-5  # exact where the nearest surface is flat
    assert np.median(error) < 1e-4
    assert np.array_equal(found[np.abs(exact) > field.step] < 0, exact[np.abs(exact) > field.step] < 0)
    assert error.max() < 1.5 * field.step  # half a cell off the medial axis at worst


def test_gradient_is_the_derivative_of_the_field():
    field = ShapeModel.of(load_workpiece("bracket")).field
    p = torch.rand((2000, 3), generator=torch.Generator().manual_seed(0)) - 0.5
    distance, gradient = field.look_up(p)
    assert torch.allclose(gradient.norm(dim=1), torch.ones(2000), atol=1e-4)
    for axis in range(3):
        h = torch.zeros(3)
        h[axis] = 1e-4
        slope = (field.look_up(p + h)[0] - field.look_up(p - h)[0]) / 2e-4
        # between two nodes the plane changes, so a few differ
        assert ((slope - gradient[:, axis]).abs() < 0.02).double().mean() > 0.97
    assert distance.min() < 0 < distance.max()


def test_exponential_map_is_that_of_scipy():
    w = np.random.default_rng(1).normal(size=(50, 3))
    w[0] = 0
    found = _exp(torch.from_numpy(w)).numpy()
    assert np.allclose(found, Rotation.from_rotvec(w).as_matrix(), atol=1e-7)


def pushed(scene, seen, position, angle_deg, seed=0):
    rng = np.random.default_rng(seed)
    T = scene.Ts_camera_part[seen]
    push = Rotation.from_rotvec(rng.normal(0, np.deg2rad(angle_deg) / 1.538, (len(T), 3))).as_matrix()
    t = T[:, :3, 3] / scene.workpiece.unit + rng.normal(0, position / 1.538, (len(T), 3))
    return torch.from_numpy((push @ T[:, :3, :3]).astype(np.float32)), torch.from_numpy(t.astype(np.float32))


def errors(scene, seen, R, t):
    T = scene.Ts_camera_part[seen]
    distance = np.linalg.norm(t.double().numpy() * scene.workpiece.unit - T[:, :3, 3], axis=1)
    return distance, np.rad2deg(rotation_angle(np.swapaxes(R.double().numpy(), 1, 2) @ T[:, :3, :3]))


def test_pushed_poses_come_back(scene):
    shape = ShapeModel.of(scene.workpiece)
    seen = scene.pixels > 0.6 * scene.pixels.max()
    surface = SurfaceMap.of(scene.frame, shape.unit, 1.2e-4)
    votes = artificial.votes_of(scene, 0, 0.05, 10, 0.2)
    surface = surface.with_centres(votes.points, votes.centres)
    R, t = register(*pushed(scene, seen, 0.05, 10), surface, shape, COARSE + FINE + LAST)
    distance, angle = errors(scene, seen, R, t)
    assert (distance < 0.002).mean() >= 0.85
    assert np.median(distance) < 0.5e-3 and np.median(angle) < 0.7


def test_true_poses_stay(scene):
    shape = ShapeModel.of(scene.workpiece)
    seen = scene.pixels > 0.6 * scene.pixels.max()
    surface = SurfaceMap.of(scene.frame, shape.unit, 1.2e-4)
    R, t = register(*pushed(scene, seen, 0.0, 0.0), surface, shape, LAST)
    distance, angle = errors(scene, seen, R, t)
    assert distance.max() < 1.5e-3 and angle.max() < 3
    assert torch.allclose(R @ R.transpose(1, 2), torch.eye(3), atol=1e-4)


def test_a_pose_that_sees_nothing_does_not_move(scene):
    shape = ShapeModel.of(scene.workpiece)
    surface = SurfaceMap.of(scene.frame, shape.unit, 1.2e-4)
    R, t = torch.eye(3)[None], torch.tensor([[40.0, 0.0, 15.0]])
    moved_R, moved_t = register(R, t, surface, shape, COARSE)
    assert torch.equal(moved_t, t) and torch.allclose(moved_R, R, atol=1e-6)


def test_normals_of_the_map_are_those_of_the_surface():
    workpiece = load_workpiece("bracket")
    scene = artificial.look(workpiece, np.zeros((0, 4, 4)), noise=False)
    surface = SurfaceMap.of(scene.frame, workpiece.unit, 1.2e-4)
    table = surface.table.numpy().reshape(480, 640, 8)
    floor = table[200:280, 280:360, 3:6]  # the middle of an empty bin faces the camera
    assert np.allclose(floor, [0, 0, -1], atol=2e-3)


def loops_and_tensors(scene, projective):
    """Normal equations of pushed poses by the compiled loops, and the tensor arithmetic that they stand for."""
    shape = ShapeModel.of(scene.workpiece)
    surface = SurfaceMap.of(scene.frame, shape.unit, 1.2e-4)
    R, t = pushed(scene, scene.pixels > 0.3 * scene.pixels.max(), 0.04, 8)
    view, threshold, count = shape.view_of(R, t), 0.06, 200
    no_votes = surface.nearest_vote.numpy(), np.zeros((0, 3), np.float32)
    found = surface_terms(
        KernelPoses(R.numpy(), t.numpy(), view.numpy()),
        CadPoints(shape.visible.numpy(), shape.visible_normals.numpy(), count),
        surface.table.numpy(),
        surface.camera,
        shape.field.arrays,
        Association(np.float32(threshold), np.float32(MIN_FACING), projective),
        VoteWeights(*no_votes, np.float32(1), np.float32(1), *shape.elongation),
    )
    a = compare(R, t, surface, shape, count)
    rows = surface.at(surface.pixels_of(a.drawn)[0])
    distance, gradient = shape.field.look_up(a.points)
    if projective:
        gradient = shape.visible_normals[:, :count][view]
        distance = ((a.points - shape.visible[:, :count][view]) * gradient).sum(-1)
    weight = (1 - (distance / threshold) ** 2).clamp(min=0) ** 2
    weight = weight * (a.measured & ((torch.bmm(rows[..., 3:6], R) * gradient).sum(-1) > MIN_FACING))
    J = torch.cat([torch.linalg.cross(a.points, gradient), gradient], -1)
    H = torch.einsum("hp,hpi,hpj->hij", weight, J, J)
    return found, (H.numpy(), torch.einsum("hp,hp,hpi->hi", weight, distance, J).numpy())


@pytest.mark.parametrize("projective", [False, True])
def test_compiled_loops_are_the_tensor_arithmetic(scene, projective):
    found, meant = loops_and_tensors(scene, projective)
    assert np.abs(meant[0]).max(axis=(1, 2)).min() > 1  # every pose has points
    for mine, theirs in zip(found, meant, strict=True):
        assert np.allclose(mine, theirs, rtol=1e-3, atol=2e-3 * np.abs(theirs).max())


def test_soft_score_is_that_of_the_compared_points(scene):
    shape = ShapeModel.of(scene.workpiece)
    surface = SurfaceMap.of(scene.frame, shape.unit, 1.2e-4)
    R, t = pushed(scene, scene.pixels >= 0, 0.05, 10)
    a, tolerance = compare(R, t, surface, shape, 100), 0.07
    near = (1 - (a.distance / tolerance) ** 2).clamp(min=0) * a.measured
    agree = near * torch.where(a.known_normal, a.facing.clamp(min=0), 0.5)
    meant = (agree - 0.7 * ((a.gap - tolerance) / tolerance).clamp(0, 1)).mean(1)
    assert torch.allclose(soft_score(R, t, surface, shape, 100, tolerance), meant, atol=1e-4)
    assert meant.std() > 0.05


def ramp_image(edge):
    """(1 * 100,) depth of a row of pixels: a surface at 1 that ends at column `edge`, the floor at 1.5 behind it."""
    return np.where(np.arange(100) < edge, 1.0, 1.5).astype(np.float32)


@pytest.mark.parametrize(("edge", "offset"), [(60, 0.10), (50, 0.0), (40, -0.10), (90, None)])
def test_outline_moves_to_the_edge_of_the_depth(edge, offset):
    """One outline point at the middle column, searched 0.2 to both sides: its offset is where the surface ends."""
    camera = np.array([100, 100, 50, 0, 100, 1], np.float32)  # 0.01 a pixel at depth 1
    pose = KernelPoses(np.eye(3, dtype=np.float32)[None], np.float32([[0, 0, 1]]), np.zeros(1, np.int64))
    outline = Outline(np.float32([[[0, 0, 0]]]), np.float32([[[1, 0, 0]]]), 1)
    search = EdgeSearch(np.float32(0.2), 21, np.float32(0.1), np.float32(1.0), ramp_image(edge), camera)
    H, s = rim_terms(pose, outline, search)
    if offset is None:
        assert not H.any() and not s.any()
    else:
        found = s[0, 3] / H[0, 3, 3]
        assert found == pytest.approx(offset, abs=0.031)  # the dead band of a step, and half a step
