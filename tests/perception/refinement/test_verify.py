"""Verification: what is there is confirmed, what the camera saw through is refuted, one surface has one owner."""

import numpy as np
import pytest
import torch

from pickproof.cell.errors import InputError
from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.refinement.depth_surface import SurfaceMap
from pickproof.perception.refinement.score_model import FEATURES, SIGNS, ScoreModel
from pickproof.perception.refinement.verify import VerifyConfig, examine, rivalry, suppress
from tests.perception import artificial

RULES = VerifyConfig()


@pytest.fixture(scope="module")
def heap():
    scene = artificial.heap()
    shape = ShapeModel.of(scene.workpiece)
    T = scene.Ts_camera_part[scene.pixels > 0.5 * scene.pixels.max()]
    R, t = (torch.from_numpy(x.astype(np.float32)) for x in (T[:, :3, :3], T[:, :3, 3] / shape.unit))
    return SurfaceMap.of(scene.frame, shape.unit, 1.2e-4), shape, R, t


def test_true_poses_are_confirmed(heap):
    surface, shape, R, t = heap
    e = examine(R, t, surface, shape, RULES)
    assert e.ratio.min() > RULES.min_ratio and e.violations.max() < 0.1  # how parts fall depends on the processor
    assert np.median(e.ratio) > 0.95 and np.median(e.violations) < 0.01
    assert np.median(e.residual) * shape.unit < 2.5e-4
    assert np.median(e.facing) > 0.95


def test_poses_in_free_space_are_refuted(heap):
    surface, shape, R, t = heap
    lifted = t - 0.5 * t / t.norm(dim=1, keepdim=True)
    e = examine(R, lifted, surface, shape, RULES)
    assert e.ratio.max() < 0.3 and e.violations.min() > 0.5


def test_poses_under_the_floor_are_hidden_and_not_refuted(heap):
    surface, shape, R, t = heap
    e = examine(R, t + 2.0 * t / t.norm(dim=1, keepdim=True), surface, shape, RULES)
    assert e.occluded.min() > 0.7 and e.violations.max() < 0.05 and e.inliers.max() < 0.05


def test_poses_outside_the_image_claim_nothing(heap):
    surface, shape, R, t = heap
    e = examine(R[:1], t[:1] + torch.tensor([30.0, 0, 0]), surface, shape, RULES)
    assert e.inliers[0] == e.violations[0] == e.occluded[0] == 0
    assert np.isfinite(e.features(0.01)).all()


def test_half_turns_are_worse_than_the_truth(heap):
    surface, shape, R, t = heap
    truth = examine(R, t, surface, shape, RULES)
    model = ScoreModel()
    for turn in shape.near_symmetries[1:]:
        turned = examine(R @ torch.from_numpy(turn.astype(np.float32)), t, surface, shape, RULES)
        better = model.score(truth.features(0.01)) > model.score(turned.features(0.01))
        assert better.mean() > 0.9


def test_votes_on_the_surface_support_a_pose(heap):
    surface, shape, R, t = heap
    scene = artificial.heap()
    votes = artificial.votes_of(scene, 0, 0.05, 8, 0.2)
    e = examine(R, t, surface, shape, RULES, votes)
    assert e.votes.min() > 10 and e.centres_agree.min() > 0.6
    assert (e.rotations_agree <= e.centres_agree).all() and e.rotations_agree.mean() > 0.5


def test_region_of_interest_takes_away_support_but_no_contradiction(heap):
    _, shape, R, t = heap
    scene = artificial.heap()
    nothing = np.zeros(scene.frame.depth.shape, dtype=bool)
    blind = SurfaceMap.of(scene.frame, shape.unit, 1.2e-4, nothing)
    assert examine(R, t, blind, shape, RULES).inliers.max() == 0
    lifted = t - 0.5 * t / t.norm(dim=1, keepdim=True)
    assert examine(R, lifted, blind, shape, RULES).violations.min() > 0.5


def test_a_copy_shares_its_surface_and_overlaps(heap):
    surface, shape, R, t = heap
    twice = torch.cat([R[:1], R[:1], R[1:2]]), torch.cat([t[:1], t[:1] + 0.01, t[1:2]])
    shared, overlap = rivalry(*twice, surface, shape, RULES)
    assert shared[0, 1] > 0.5 and shared[1, 0] > 0.5
    assert shared[0, 2] < 0.3 and overlap[0, 2] < 0.05
    assert np.diag(shared).max() == 0
    assert suppress(np.array([1, 0, 2]), shared, overlap, RULES) == [1, 2]


def test_poses_that_pierce_each_other_cannot_both_be(heap):
    surface, shape, R, t = heap
    across = R[:1] @ torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    shared, overlap = rivalry(torch.cat([R[:1], across]), torch.cat([t[:1], t[:1]]), surface, shape, RULES)
    assert overlap.max() > RULES.max_overlap
    assert suppress(np.array([0, 1]), shared, overlap, RULES) == [0]


def test_fit_finds_the_odds_that_made_the_labels():
    rng = np.random.default_rng(0)
    true = ScoreModel(tuple(np.linspace(0.2, 2, len(FEATURES)) * SIGNS), 0.5)
    X = rng.normal(size=(20000, len(FEATURES)))
    right = rng.random(len(X)) < true.score(X)
    found = ScoreModel.fit(X, right)
    assert np.allclose(found.weights, true.weights, atol=0.15) and found.bias == pytest.approx(0.5, abs=0.1)
    scores = found.score(X)
    for low in np.arange(0.05, 0.95, 0.1):
        among = (scores > low) & (scores < low + 0.1)
        assert right[among].mean() == pytest.approx(scores[among].mean(), abs=0.05)


def test_fit_survives_labels_that_are_all_alike():
    X = np.random.default_rng(0).normal(size=(50, len(FEATURES)))
    assert np.isfinite(ScoreModel.fit(X, np.ones(50, dtype=bool)).score(X)).all()


def test_score_model_round_trip_and_errors(tmp_path):
    model = ScoreModel(tuple(float(i) for i in range(len(FEATURES))), -1.0)
    path = tmp_path / "score.json"
    model.save(path)
    assert ScoreModel.load(path) == model
    path.write_text("{}")
    with pytest.raises(InputError, match="numbers for bias and"):
        ScoreModel.load(path)
    with pytest.raises(InputError, match="missing"):
        ScoreModel.load(tmp_path / "missing.json")
