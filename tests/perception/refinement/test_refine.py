"""Refinement as a whole: right poses from weak votes, none from nothing, and the same ones every time."""

import numpy as np
import pytest

from pickproof.cell.frames import from_rpy, make_transform
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.perception.evaluation.metrics import score_frame, summarise, visible_instances
from pickproof.perception.ps6d.votes import Votes
from pickproof.perception.refinement.refine import RefineConfig, refine
from tests.perception import artificial

CONFIG = RefineConfig()


def scored(scene, estimates):
    found = np.array([e.T_camera_part for e in estimates]).reshape(-1, 4, 4)
    return score_frame(found, scene.Ts_camera_part, visible_instances(scene.pixels), scene.workpiece)


@pytest.mark.parametrize(
    ("position", "angle_deg", "outliers", "least_f1"), [(0.12, 25, 0.3, 0.85), (0.15, 40, 0.55, 0.6)]
)
def test_weak_votes_become_right_poses(position, angle_deg, outliers, least_f1):
    scene = artificial.heap()
    result = refine(scene.frame, scene.workpiece, artificial.votes_of(scene, 1, position, angle_deg, outliers), CONFIG)
    refined = summarise([scored(scene, result.estimates)])
    assert refined.precision >= 0.9 and refined.f1_inst >= least_f1
    assert refined.f1_inst >= summarise([scored(scene, result.raw)]).f1_inst
    assert refined.median_mm < 0.6 and refined.median_deg < 1.0
    for e in result.estimates:
        assert np.allclose(e.T_camera_part[:3, :3] @ e.T_camera_part[:3, :3].T, np.eye(3), atol=1e-9)
        assert 0 <= e.visible_share <= 1 and e.residual < 1e-3 and e.n_votes >= 0
    scores = [e.score for e in result.estimates]
    assert scores == sorted(scores, reverse=True) and all(0 <= s <= 1 for s in scores)


def test_random_rotations_give_no_wrong_poses():
    scene = artificial.heap()
    result = refine(scene.frame, scene.workpiece, artificial.votes_of(scene, 2, 0.3, 90, 1.0), CONFIG)
    s = scored(scene, result.estimates)
    assert s.n_pred - s.true_positives <= 1


def test_same_input_same_output_to_the_last_bit():
    scene = artificial.heap()
    votes = artificial.votes_of(scene, 3, 0.12, 25, 0.3)
    a, b = (refine(scene.frame, scene.workpiece, votes, CONFIG) for _ in range(2))
    for one, two in ((a.estimates, b.estimates), (a.raw, b.raw)):
        assert len(one) == len(two) > 0
        for x, y in zip(one, two, strict=True):
            assert np.array_equal(x.T_camera_part, y.T_camera_part) and x.score == y.score


def test_no_votes_and_broken_votes():
    scene = artificial.heap()
    none = Votes(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3)))
    assert refine(scene.frame, scene.workpiece, none, CONFIG).estimates == []
    votes = artificial.votes_of(scene, 4, 0.05, 10, 0.1)
    centres = votes.centres.copy()
    centres[::3] = np.nan
    broken = Votes(votes.points, centres, votes.rotations, votes.cad_coordinates)
    assert len(refine(scene.frame, scene.workpiece, broken, CONFIG).estimates) > 0


def test_a_blind_camera_confirms_nothing():
    scene = artificial.heap()
    votes = artificial.votes_of(scene, 5, 0.05, 10, 0.1)
    blind = DepthFrame(np.zeros_like(scene.frame.depth), scene.frame.intrinsics, scene.frame.T_world_camera)
    result = refine(blind, scene.workpiece, votes, CONFIG)
    assert result.estimates == [] and len(result.raw) > 0
    outside = np.zeros(scene.frame.depth.shape, dtype=bool)
    assert refine(scene.frame, scene.workpiece, votes, CONFIG, roi=outside).estimates == []


def test_estimates_are_read_only_and_stages_are_timed():
    scene = artificial.heap()
    result = refine(scene.frame, scene.workpiece, artificial.votes_of(scene, 6, 0.05, 10, 0.1), CONFIG)
    with pytest.raises(ValueError, match="read-only"):
        result.estimates[0].T_camera_part[0, 0] = 2.0
    assert set(result.seconds) == {"cluster", "surface", "hypotheses", "icp", "verify"}


@pytest.mark.parametrize("make", [artificial.bar, artificial.rod])
def test_symmetric_workpieces_are_found_up_to_their_symmetry(make):
    workpiece = make()
    rng = np.random.default_rng(0)
    lying = make_transform(t=(0, 0, 0.005)) if make is artificial.bar else from_rpy((0, 0, 0.008), (np.pi / 2, 0, 0))
    spots = [(-0.05, -0.03), (0.03, -0.03), (-0.04, 0.03), (0.04, 0.03)]
    Ts = np.stack([make_transform(t=(x, y, 0)) @ from_rpy((0, 0, 0), (0, 0, rng.uniform(-0.5, 0.5))) for x, y in spots])
    scene = artificial.look(workpiece, Ts @ lying)
    votes = artificial.votes_of(scene, 0, 0.08, 15, 0.2, count=400)
    S = workpiece.symmetry.rotations(12)
    turned = votes.rotations @ S[rng.integers(0, len(S), len(votes))]  # as a network sees it: any symmetry will do
    result = refine(scene.frame, workpiece, Votes(votes.points, votes.centres, turned), CONFIG)
    refined = summarise([scored(scene, result.estimates)])
    assert refined.precision == 1.0 and refined.instance_recall >= 0.75
    assert refined.median_mm < 1.0 and refined.median_deg < 1.5
