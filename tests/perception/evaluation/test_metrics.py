"""Metrics against numbers worked out by hand."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pickproof.cell.frames import make_transform, random_rotations
from pickproof.cell.symmetry.pose_error import point_distances, rotation_error
from pickproof.cell.symmetry.symmetry import Symmetry
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.perception.evaluation.metrics import score_frame, summarise, visible_instances
from tests.perception import artificial

BRACKET = load_workpiece("bracket")
EVERYTHING = np.ones(3, dtype=bool)


def poses(*positions):
    return np.stack([make_transform(t=p) for p in positions])


THREE = poses((0, 0, 0), (0.1, 0, 0), (0.2, 0, 0))


def test_visibility_is_relative_to_the_best_seen_instance():
    assert visible_instances(np.array([100, 41, 40, 0])).tolist() == [True, True, False, False]
    assert visible_instances(np.array([0, 0])).tolist() == [False, False]
    assert visible_instances(np.zeros(0)).tolist() == []


def test_perfect_predictions_in_any_order():
    s = score_frame(THREE[[2, 0, 1]], THREE, EVERYTHING, BRACKET)
    assert (s.n_gt, s.n_pred, s.true_positives) == (3, 3, 3)
    assert s.matched.tolist() == [2, 0, 1]
    whole = summarise([s])
    assert (whole.f1_inst, whole.recall, whole.precision, whole.median_mm) == (1, 1, 1, 0)


def test_f1_by_hand():
    # one right by 2 mm, one wrong by 8 mm, one instance unseen: TP 1, N_pred 2, N_gt 3
    s = score_frame(poses((0.002, 0, 0), (0.108, 0, 0)), THREE, EVERYTHING, BRACKET)
    whole = summarise([s])
    assert whole.f1_inst == pytest.approx(2 * 1 / (2 + 3))
    assert 1 / whole.f1_inst == pytest.approx(((2 / 1) + (3 / 1)) / 2)  # the paper's form
    assert whole.precision == pytest.approx(1 / 2)
    assert whole.recall == pytest.approx(1 / 3)  # shifted as a whole, all points of one of three are within 5 mm
    assert whole.median_mm == pytest.approx(2.0)
    assert whole.median_deg == pytest.approx(0.0, abs=1e-9)


def test_recall_counts_points_and_not_instances():
    # turned about its middle until only points within r = T_e / (2 sin(a / 2)) of the axis stay within T_e
    points = np.stack([np.linspace(-0.02, 0.02, 401), np.zeros(401), np.zeros(401)], 1)
    angle = 2 * np.arcsin(0.005 / 2 / 0.01)  # r = 10 mm: half of the points
    T = make_transform(Rotation.from_rotvec([0, 0, angle]).as_matrix())[None]
    s = score_frame(T, THREE[:1], EVERYTHING[:1], BRACKET, points=points)
    assert s.recall_points / s.all_points == pytest.approx(0.5, abs=0.01)


def test_second_prediction_of_an_instance_is_false():
    s = score_frame(poses((0.001, 0, 0), (0, 0, 0)), THREE[:1], EVERYTHING[:1], BRACKET)
    assert (s.true_positives, s.n_pred, s.n_gt) == (1, 2, 1)
    assert s.matched.tolist() == [-1, 0]  # the nearer one is the match


def test_hidden_instance_counts_for_nothing_and_excuses_one_prediction():
    counted = np.array([True, False, True])
    right = score_frame(THREE, THREE, counted, BRACKET)
    assert (right.n_gt, right.n_pred, right.true_positives) == (2, 2, 2)
    wrong = score_frame(poses((0, 0, 0), (0.107, 0, 0)), THREE, counted, BRACKET)
    assert (wrong.n_gt, wrong.n_pred, wrong.true_positives) == (2, 2, 1)
    twice = score_frame(poses((0.1, 0, 0), (0.101, 0, 0)), THREE, counted, BRACKET)
    assert (twice.n_pred, twice.true_positives) == (1, 0)


def test_empty_frames():
    none = np.zeros((0, 4, 4))
    whole = summarise([score_frame(none, none, np.zeros(0, dtype=bool), BRACKET)])
    assert (whole.f1_inst, whole.recall, whole.precision) == (1, 1, 1) and np.isnan(whole.median_mm)
    missed = summarise([score_frame(none, THREE, EVERYTHING, BRACKET)])
    assert (missed.f1_inst, missed.recall, missed.instance_recall) == (0, 0, 0)
    ghosts = summarise([score_frame(THREE, none, np.zeros(0, dtype=bool), BRACKET)])
    assert (ghosts.f1_inst, ghosts.precision) == (0, 0)


def test_totals_are_over_all_frames():
    good = score_frame(THREE, THREE, EVERYTHING, BRACKET)
    bad = score_frame(np.zeros((0, 4, 4)), THREE[:1], EVERYTHING[:1], BRACKET)
    assert summarise([good, bad]).f1_inst == pytest.approx(2 * 3 / (3 + 4))


@pytest.mark.parametrize("make", [artificial.bar, artificial.rod])
def test_symmetric_poses_are_one_pose(make):
    workpiece = make()
    points = workpiece.sample_surface(300)[0]
    T = make_transform(random_rotations(1, np.random.default_rng(0))[0], (0.1, 0.2, 0.8))
    for s in workpiece.symmetry.rotations(7):
        same = T @ make_transform(s)
        assert point_distances(same, T, points, workpiece.symmetry).max() < 1e-12
        assert rotation_error(same[:3, :3], T[:3, :3], workpiece.symmetry) < 1e-6
    tilted = T @ make_transform(Rotation.from_rotvec([0.3, 0, 0]).as_matrix())
    assert rotation_error(tilted[:3, :3], T[:3, :3], workpiece.symmetry) == pytest.approx(0.3)


def test_distance_of_a_rod_is_that_of_its_axis():
    points = np.array([[0.005, 0, 0.03], [0, -0.005, -0.03]])
    symmetry = Symmetry((0, 0, 1))
    T = make_transform(Rotation.from_rotvec([0, 0.2, 0]).as_matrix())
    # the points fall onto the axis at 30 mm from the middle and move by 2 x 30 mm x sin(a / 2)
    assert np.allclose(point_distances(np.eye(4), T, points, symmetry), 2 * 0.03 * np.sin(0.1))


def test_sphere_is_its_centre():
    symmetry = Symmetry((1, 1, 1))
    T = make_transform(random_rotations(1, np.random.default_rng(0))[0], (0.003, 0, 0))
    assert np.allclose(point_distances(np.eye(4), T, np.ones((4, 3)), symmetry), 0.003)
    assert rotation_error(np.eye(3), T[:3, :3], symmetry) == 0
