"""The PPF peer on rendered scenes of real parts."""

import functools

import numpy as np
import pytest

from pickproof.cell.frames import from_rpy
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.perception.benchmark.ppf import Ppf, PpfConfig
from pickproof.perception.evaluation.average_precision import pose_distances
from pickproof.perception.evaluation.metrics import score_frame, summarise, visible_instances
from tests.perception import artificial

pytestmark = pytest.mark.slow


@functools.lru_cache
def ppf(name="bracket"):
    return Ppf.train(load_workpiece(name))


def scored(found, scene):
    Ts = np.stack([e.T_camera_part for e in found])
    return summarise([score_frame(Ts, scene.Ts_camera_part, visible_instances(scene.pixels), scene.workpiece)])


@pytest.mark.parametrize("name", ["bracket", "tless_20"])
def test_a_part_that_lies_alone_is_found(name):
    part = load_workpiece(name)
    T = from_rpy((0.01, 0.0, part.extents[2] / 2), (0, 0, 0.4))
    scene = artificial.look(part, T[None])
    (estimate,) = ppf(name).detect(scene.frame, artificial.BIN, 1)
    assert scored([estimate], scene).f1_inst == 1
    assert 0 < estimate.score <= 1 and estimate.n_votes > 0 and estimate.residual >= 0


def test_some_of_a_heap_are_found_and_none_twice():
    scene = artificial.heap()
    count = int(visible_instances(scene.pixels).sum())
    found = ppf().detect(scene.frame, artificial.BIN, count)
    assert len(found) == count
    centres = np.stack([e.T_camera_part[:3, 3] for e in found])
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=-1)[~np.eye(count, dtype=bool)]
    assert apart.min() > 0.5 * scene.workpiece.extents.min()
    assert scored(found, scene).instance_recall > 0.15  # 2 of 11; chance finds none
    votes = [e.n_votes for e in found]
    assert votes == sorted(votes, reverse=True)


def test_icp_brings_the_part_closer():
    part = load_workpiece("bracket")
    scene = artificial.look(part, from_rpy((0.0, 0.0, part.extents[2] / 2), (0, 0, 1.0))[None])
    coarse = Ppf.train(part, PpfConfig(icp_iterations=0)).detect(scene.frame, artificial.BIN, 1)
    fine = ppf().detect(scene.frame, artificial.BIN, 1)
    before, after = (pose_distances(e[0].T_camera_part[None], scene.Ts_camera_part, part) for e in (coarse, fine))
    assert after[0, 0] < 0.5 * before[0, 0]


def test_detection_is_repeatable():
    scene = artificial.heap()
    first, second = (ppf().detect(scene.frame, artificial.BIN, 3) for _ in range(2))
    assert all(np.array_equal(a.T_camera_part, b.T_camera_part) for a, b in zip(first, second, strict=True))


def test_nothing_to_find():
    part = load_workpiece("bracket")
    empty = artificial.look(part, np.zeros((0, 4, 4)))
    assert ppf().detect(empty.frame, artificial.BIN, 5) == []
    blind = DepthFrame(np.zeros_like(empty.frame.depth), empty.frame.intrinsics, empty.frame.T_world_camera)
    assert ppf().detect(blind, artificial.BIN, 5) == []
    assert ppf().detect(artificial.heap().frame, artificial.BIN, 0) == []
