"""Registration: the field is the distance, its Jacobian the derivative, and poses come back after a push."""

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

from cell.frames import rotation_angle
from cell.workpiece import load_workpiece
from perception.distance_field import DistanceField
from perception.icp import COARSE, FINE, LAST, _exp, register
from perception.shape_model import ShapeModel
from perception.surface_map import SurfaceMap
from tests.perception import artificial


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
