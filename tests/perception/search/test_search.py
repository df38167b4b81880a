"""Brackets of a settled heap are found without any training."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
import torch

from pickproof.cell.frames import from_rpy
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.estimate import Perception, method_for
from pickproof.perception.evaluation.metrics import score_frame, visible_instances
from pickproof.perception.ps6d.cloud import roi_mask
from pickproof.perception.refinement.depth_surface import SurfaceMap
from pickproof.perception.refinement.refine import RefineResult
from pickproof.perception.search.decision import ALONE, FEATURES
from pickproof.perception.search.outside import outside
from pickproof.perception.search.poses import Poses
from pickproof.perception.search.search import Search
from pickproof.perception.search.slide import slid
from tests.perception.artificial import BIN, Scene, heap, look

pytestmark = pytest.mark.slow


@lru_cache(maxsize=1)
def searching() -> Search:
    return Search.of(load_workpiece("bracket"))


def find(scene: Scene, seed: int = 0) -> RefineResult:
    return searching().find(scene.frame, roi_mask(scene.frame, BIN), BIN, np.random.default_rng(seed))


def poses_of(result: RefineResult) -> np.ndarray:
    return np.array([e.T_camera_part for e in result.estimates]).reshape(-1, 4, 4)


def test_every_visible_bracket_is_found_and_no_other():
    scene = heap()
    result = find(scene)
    found = score_frame(poses_of(result), scene.Ts_camera_part, visible_instances(scene.pixels), scene.workpiece)
    assert found.true_positives >= found.n_gt - 1
    assert found.n_pred - found.true_positives <= 1
    scores = [e.score for e in result.estimates]
    assert scores == sorted(scores, reverse=True)
    assert min(scores) >= ALONE.threshold
    assert set(result.seconds) == {"surface", "search", "coarse", "icp", "verify"}


def test_one_seed_gives_one_result():
    first, again = find(heap(), 3), find(heap(), 3)
    np.testing.assert_array_equal(poses_of(first), poses_of(again))
    assert [e.score for e in first.estimates] == [e.score for e in again.estimates]


def test_every_examined_pose_has_features_and_a_score():
    examined = find(heap()).examined
    assert examined is not None
    h = len(examined.Ts_camera_part)
    assert examined.features.shape == (h, len(FEATURES))
    assert np.isfinite(examined.features).all()
    assert ((examined.scores >= 0) & (examined.scores <= 1)).all()
    assert set(examined.standing) <= set(range(h))


def test_an_empty_bin_holds_nothing():
    scene = look(load_workpiece("bracket"), np.zeros((0, 4, 4)))
    assert find(scene).estimates == []
    nowhere = np.zeros(scene.frame.depth.shape, dtype=bool)
    assert searching().find(scene.frame, nowhere, None, np.random.default_rng(0)).estimates == []


def test_a_network_and_the_search_decide_together():
    scene = heap()
    both = Perception.load(scene.workpiece, method="both")
    result = both.perceive(scene.frame, BIN, np.random.default_rng(0))
    found = score_frame(poses_of(result), scene.Ts_camera_part, visible_instances(scene.pixels), scene.workpiece)
    assert found.true_positives >= found.n_gt - 1
    assert found.n_pred - found.true_positives <= 1
    assert {"network", "search", "hypotheses"} <= set(result.seconds)


def test_auto_takes_the_network_where_there_are_weights(tmp_path):
    workpiece = load_workpiece("bracket")
    without = replace(workpiece, folder=tmp_path)
    assert method_for(workpiece, "auto") == "ps6d"
    assert method_for(without, "auto") == "search"
    assert method_for(without, "auto", tmp_path / "given.safetensors") == "ps6d"
    assert method_for(workpiece, "search") == "search"
    assert Perception.load(without).network is None


def test_what_lies_below_the_floor_or_in_a_wall_is_outside():
    scene = heap()
    shape = ShapeModel.of(scene.workpiece)
    T = scene.Ts_camera_part
    R = torch.from_numpy(T[:, :3, :3].astype(np.float32))
    t = torch.from_numpy((T[:, :3, 3] / shape.unit).astype(np.float32))
    assert outside(R, t, shape, scene.frame, BIN).max() < 0.02
    deeper = t + torch.tensor([0.0, 0.0, 0.2])
    assert outside(R, deeper, shape, scene.frame, BIN).mean() > 0.1
    aside = t + torch.tensor([BIN.inner[0] / shape.unit, 0.0, 0.0])
    assert outside(R, aside, shape, scene.frame, BIN).min() > 0.9
    assert (outside(R, deeper, shape, scene.frame, None) == 0).all()


@pytest.mark.parametrize("along", [-0.1, 0.0, 0.14])
def test_a_slender_part_slides_back_to_its_place(along):
    workpiece = load_workpiece("ps6d_23")
    shape = ShapeModel.of(workpiece)
    T = from_rpy((0.0, 0.0, 0.02), (0.0, 0.0, 0.7))
    small = replace(workpiece, vertices=workpiece.vertices * 0.1)  # fits the bin of these tests
    shape = ShapeModel.of(small)
    scene = look(small, T[None])
    surface = SurfaceMap.of(scene.frame, shape.unit, scene.frame.sigma, roi_mask(scene.frame, BIN))
    true = scene.Ts_camera_part[0]
    t = true[:3, 3] / shape.unit + along * true[:3, :3] @ shape.long_axis
    start = Poses(*(torch.from_numpy(x[None].astype(np.float32)) for x in (true[:3, :3], t)), np.zeros(1))
    end = slid(start, surface, shape, 384, 0.03)
    off = end.positions[0].numpy() - true[:3, 3] / shape.unit
    assert abs(off @ (true[:3, :3] @ shape.long_axis)) < 0.03
