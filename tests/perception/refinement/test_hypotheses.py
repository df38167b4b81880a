"""Hypotheses: exact alignment, near symmetries, places found by position alone, and the truth among what is kept."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from pickproof.cell.frames import random_rotations, rotation_angle
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.ps6d.votes import Votes
from pickproof.perception.ps6d.voting import Categories, ClusterConfig, Modes, cluster
from pickproof.perception.refinement.depth_surface import SurfaceMap
from pickproof.perception.refinement.hypotheses import (
    GATHER_ROUNDS,
    Hypotheses,
    HypothesisConfig,
    best_of_each_place,
    find_places,
    gather,
    kabsch,
    propose,
)
from tests.perception import artificial


def test_kabsch_recovers_the_pose_of_each_group():
    rng = np.random.default_rng(0)
    R, t = random_rotations(3, rng), rng.normal(size=(3, 3))
    model, groups = rng.normal(size=(40, 3)), rng.permutation(np.arange(40) % 3)
    measured = (R[groups] @ model[..., None])[..., 0] + t[groups]
    found_R, found_t = kabsch(model, measured, groups, 3)
    assert np.allclose(found_R, R) and np.allclose(found_t, t)


def test_near_symmetries_are_rotations_that_nearly_keep_the_surface():
    shape = ShapeModel.of(load_workpiece("bracket"))
    near = shape.near_symmetries
    assert np.allclose(near[0], np.eye(3)) and len(near) >= 4
    assert np.allclose(near @ np.swapaxes(near, 1, 2), np.eye(3)) and np.allclose(np.linalg.det(near), 1)
    for R in near:
        distance = shape.field.look_up(torch.from_numpy((shape.points @ R.T).astype(np.float32)))[0]
        assert float(distance.abs().mean()) < 0.07


def test_true_symmetries_are_not_near_symmetries():
    shape = ShapeModel.of(artificial.bar())
    for R in shape.near_symmetries[1:]:
        assert min(rotation_angle(R.T @ s) for s in shape.symmetry.S) > 0.1


def test_best_of_each_place_keeps_the_best_that_differ():
    shape = ShapeModel.of(load_workpiece("bracket"))
    t = torch.tensor([[0.0, 0, 15], [0.01, 0, 15], [0.3, 0, 15], [0.5, 0, 15], [9, 0, 15]])
    many = Hypotheses(torch.eye(3).expand(5, 3, 3), t, np.array([0, 0, 0, 0, 1]), np.array([0.9, 0.8, 0.5, 0.6, 0.1]))
    assert best_of_each_place(many, shape, 2, 0.05).tolist() == [0, 3, 4]
    assert best_of_each_place(many, shape, 2, 0.0).tolist() == [0, 1, 4]


def test_places_are_found_where_rotations_agree_on_nothing():
    rng = np.random.default_rng(1)
    truth = np.array([[0.0, 0, 15], [1, 0, 15], [0, 1, 15]])
    centres = np.repeat(truth, 30, axis=0) + rng.normal(0, 0.03, (90, 3))
    votes = Votes(centres, centres, random_rotations(90, rng))
    shape = ShapeModel.of(load_workpiece("bracket"))
    modes, categories = cluster(votes, shape, ClusterConfig())
    places = find_places(votes, modes, categories, shape, HypothesisConfig())
    gaps = np.linalg.norm(places.positions[:, None] - truth, axis=-1)
    assert (gaps.min(0) < 0.05).all() and (gaps.min(1) < 0.15).all()
    assert (places.of_vote >= 0).mean() > 0.95


def test_no_votes_no_places():
    places = find_places(
        Votes(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3))),
        Modes.none(0), Categories.none(), ShapeModel.of(load_workpiece("bracket")), HypothesisConfig(),
    )  # fmt: skip
    assert len(places.positions) == 0


@pytest.mark.parametrize("cad", [True, False])
def test_the_truth_is_among_the_hypotheses_of_weak_votes(cad):
    scene = artificial.heap()
    shape = ShapeModel.of(scene.workpiece)
    votes = artificial.votes_of(scene, 0, position=0.12, angle_deg=25, outliers=0.3)
    if not cad:
        votes = Votes(votes.points, votes.centres, votes.rotations)
    surface = SurfaceMap.of(scene.frame, shape.unit, 1.2e-4)
    modes, categories = cluster(votes, shape, ClusterConfig())
    places = find_places(votes, modes, categories, shape, HypothesisConfig())
    found = propose(votes, modes, categories, places, surface, shape, HypothesisConfig())
    embedded = shape.embed(found.rotations.double().numpy())
    seen = scene.pixels > 0.5 * scene.pixels.max()
    for T in scene.Ts_camera_part[seen]:
        turn = np.linalg.norm(embedded - shape.embed(T[:3, :3]), axis=1)
        shift = np.linalg.norm(found.positions.numpy() - T[:3, 3] / shape.unit, axis=1)
        assert np.hypot(turn, shift).min() < 0.15


def slender_votes(seed: int) -> tuple[ShapeModel, np.ndarray, np.ndarray, Votes]:
    """Votes on a slender part in one pose: directions off by 4 degrees, CAD coordinates by 0.1 units along it."""
    rng = np.random.default_rng(seed)
    shape = ShapeModel.of(load_workpiece("ps6d_23"))
    R, t = random_rotations(1, rng)[0], np.array([0.3, -0.2, 3.0])
    cad = shape.points[rng.choice(len(shape.points), 300, replace=False)]
    points = cad @ R.T + t
    turns = Rotation.from_rotvec(np.deg2rad(4) / 1.538 * rng.normal(size=(300, 3))).as_matrix()
    rotations = turns @ R
    guessed = cad + rng.normal(0, 0.1, (300, 1)) * shape.long_axis + rng.normal(0, 0.01, (300, 3))
    centres = points - np.einsum("nij,nj->ni", rotations, guessed)
    return shape, R, t, Votes(points, centres, rotations, guessed)


def test_gathered_poses_of_a_slender_part_are_far_better_than_the_votes():
    shape, R, t, votes = slender_votes(0)
    seeds = slice(0, 300, 20)
    found_R, found_t = gather(votes.rotations[seeds], votes.centres[seeds], votes, shape, GATHER_ROUNDS)

    def errors(Rs: np.ndarray, ts: np.ndarray) -> tuple[float, float]:
        cosine = np.abs(Rs @ shape.long_axis @ (R @ shape.long_axis))
        away = (ts - t) - ((ts - t) @ (R @ shape.long_axis))[:, None] * (R @ shape.long_axis)
        return (
            float(np.rad2deg(np.arccos(np.clip(np.median(cosine), 0, 1)))),
            float(np.median(np.linalg.norm(away, axis=1))),
        )

    before, after = errors(votes.rotations[seeds], votes.centres[seeds]), errors(found_R, found_t)
    assert before[0] > 2 and before[1] > 0.02
    assert after[0] < 0.5 and after[1] < 0.01
    assert np.allclose(found_R @ np.swapaxes(found_R, 1, 2), np.eye(3), atol=1e-4)


def test_folding_divides_what_lies_along_a_slender_part_and_leaves_compact_ones():
    shape, R, t, _ = slender_votes(1)
    axis = R @ shape.long_axis
    across = np.cross(axis, [0.0, 0, 1])
    p = t + np.array([axis, across, 0 * axis])
    folded = shape.fold(p, np.stack([R] * 3), t)
    assert np.allclose(folded - t, [axis / shape.length, across, 0 * axis])
    compact = ShapeModel.of(load_workpiece("bracket"))
    assert np.allclose(compact.fold(p, np.stack([R] * 3), t), p)
