"""Poses that are one and the same, and the points that lie on them."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.search.coverage import kept_by_points, poses_at
from pickproof.perception.search.poses import Poses, turned_alike
from pickproof.perception.search.seeds import Seeds
from tests.perception.artificial import bar


def poses(R: np.ndarray, t: np.ndarray, scores: np.ndarray) -> Poses:
    return Poses(torch.from_numpy(R.astype(np.float32)), torch.from_numpy(t.astype(np.float32)), scores)


def test_of_poses_closer_than_asked_the_best_stays():
    shape = ShapeModel.of(load_workpiece("bracket"))
    R = Rotation.from_rotvec([[0, 0, 0], [0, 0, 0.01], [0, 0, 1.0], [0, 0, 0]]).as_matrix()
    t = np.array([[0, 0, 10], [0, 0, 10], [0, 0, 10], [0.2, 0, 10]])
    kept = poses(R, t, np.array([0.5, 0.9, 0.7, 0.1])).distinct(shape, 0.05)
    assert kept.scores.tolist() == [0.9, 0.7, 0.1]
    assert len(poses(R, t, np.array([0.5, 0.9, 0.7, 0.1])).distinct(shape, 0.05, most=2)) == 2


def test_rotations_that_look_alike_become_equal():
    symmetry = bar().symmetry
    R = Rotation.random(20, random_state=0).as_matrix()
    first = turned_alike(R, symmetry)
    for s in symmetry.S:
        np.testing.assert_allclose(turned_alike(R @ s, symmetry), first, atol=1e-12)
    back = np.einsum("hji,hjk->hik", R, first)
    assert all(np.abs(symmetry.S - b).max((1, 2)).min() < 1e-12 for b in back)


def test_a_point_keeps_the_first_poses_on_whose_surface_it_lies():
    shape = ShapeModel.of(load_workpiece("bracket"))
    R = np.stack([Rotation.random(random_state=3).as_matrix()] * 3)
    t = np.array([[0.0, 0, 10], [0.3, 0, 10], [0.0, 0, 10.005]])
    index = np.arange(0, len(shape.points), 50)
    points = shape.points[index] @ R[0].T + t[0]
    normals = shape.normals[index] @ R[0].T
    seeds = Seeds(points.astype(np.float32), normals.astype(np.float32))
    at = poses_at(seeds, poses(R, t, np.ones(3)), shape, 0.02, 2)
    assert (at[:, 0] == 0).mean() > 0.85  # but at sharp edges, whose gradient is that of either face
    assert (at[:, 1] == 2).mean() > 0.8
    assert kept_by_points(at).tolist()[:1] == [0]
    turned_away = Seeds(seeds.points, -seeds.normals)
    assert (poses_at(turned_away, poses(R, t, np.ones(3)), shape, 0.005, 2)[:, 0] == 0).mean() < 0.05
