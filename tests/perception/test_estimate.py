"""A frame in, verified poses out: the shipped weights on small heaps."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from pickproof.cell.frames import Array, about_axis, invert
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.cell.sensing.sensor_model import measure
from pickproof.cell.symmetry.pose_error import point_distances
from pickproof.perception.data.scenes import heap_bin, overhead_view, render_heap
from pickproof.perception.estimate import Perception
from pickproof.perception.evaluation.metrics import visible_instances
from pickproof.perception.refinement.refine import RefineResult
from tests.perception.small_heaps import bracket, small_heaps


@lru_cache(maxsize=1)
def perception() -> Perception:
    return Perception.load(bracket())


@lru_cache(maxsize=4)
def seen(heap: int) -> tuple[DepthFrame, Array, np.ndarray]:
    """A measured frame, the true poses in the camera, and which workpieces are well visible."""
    view, poses = overhead_view(bracket()), small_heaps()[heap]
    exact = render_heap(bracket(), poses, view)
    frame = measure(exact, view.intrinsics, view.T_world_camera, view.sensor, np.random.default_rng(heap))
    visible = visible_instances(np.bincount(exact.ids[exact.ids >= 0], minlength=len(poses)))
    return frame, invert(view.T_world_camera) @ poses, visible


@lru_cache(maxsize=4)
def perceived(heap: int, seed: int = 0) -> RefineResult:
    return perception().perceive(seen(heap)[0], heap_bin(bracket()), np.random.default_rng(seed))


def nearest(T: Array, truth: Array) -> tuple[int, float]:
    d = point_distances(truth, T[None], bracket().sample_surface(200)[0], bracket().symmetry).mean(-1)
    return int(d.argmin()), float(d.min())


def test_most_visible_workpieces_are_found_within_tolerance() -> None:
    _, truth, visible = seen(0)
    matches = [nearest(e.T_camera_part, truth) for e in perceived(0).estimates]
    right = {i for i, d in matches if d < bracket().tolerance}
    assert np.mean([i in right for i in np.flatnonzero(visible)]) > 0.7
    assert np.mean([d < bracket().tolerance for _, d in matches]) > 0.8
    assert np.median([d for _, d in matches]) < 0.001


def test_estimates_are_what_their_fields_say() -> None:
    estimates = perceived(0).estimates
    assert estimates
    for e in estimates:
        R = e.T_camera_part[:3, :3]
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-6)
        np.testing.assert_allclose(e.T_camera_part[3], [0, 0, 0, 1])
        assert np.linalg.det(R) > 0
        assert 0 <= e.score <= 1 and 0 <= e.visible_share <= 1
        assert 0 <= e.residual < 0.005
        with pytest.raises(ValueError, match="read-only"):
            e.T_camera_part[0, 3] = 0.0
    scores = [e.score for e in estimates]
    assert scores == sorted(scores, reverse=True)


def test_the_same_frame_and_seed_give_the_same_poses() -> None:
    again = perception().perceive(seen(0)[0], heap_bin(bracket()), np.random.default_rng(0))
    assert len(again.estimates) == len(perceived(0).estimates)
    for a, b in zip(again.estimates, perceived(0).estimates, strict=True):
        np.testing.assert_array_equal(a.T_camera_part, b.T_camera_part)
        assert a.score == b.score


def test_perception_sees_depth_alone_and_does_not_change_it() -> None:
    frame = seen(0)[0]
    assert not frame.depth.flags.writeable
    assert set(vars(frame)) == {"depth", "intrinsics", "T_world_camera", "sigma"}


def test_where_the_cell_stands_in_the_world_does_not_matter() -> None:
    """Camera and bin moved together: the poses in the camera stay."""
    frame, _, _ = seen(0)
    G = about_axis((0, 0, 1), np.array(0.8))
    G[:3, 3] = (1.0, -2.0, 0.5)
    bin = heap_bin(bracket())
    moved_bin = type(bin)(bin.name, bin.inner, bin.wall, tuple((G @ [*bin.position, 1.0])[:3].tolist()), 0.8)
    moved = DepthFrame(frame.depth, frame.intrinsics, G @ frame.T_world_camera, frame.sigma)
    result = perception().perceive(moved, moved_bin, np.random.default_rng(0))
    assert len(result.estimates) == len(perceived(0).estimates)
    for a, b in zip(result.estimates, perceived(0).estimates, strict=True):
        np.testing.assert_allclose(a.T_camera_part, b.T_camera_part, atol=1e-5)


def test_an_empty_bin_and_a_blind_camera_give_no_estimates() -> None:
    view = overhead_view(bracket())
    exact = render_heap(bracket(), np.zeros((0, 4, 4)), view)
    empty = measure(exact, view.intrinsics, view.T_world_camera, view.sensor, np.random.default_rng(0))
    blind = DepthFrame(np.zeros((480, 640), np.float32), view.intrinsics, view.T_world_camera)
    for frame in (empty, blind):
        result = perception().perceive(frame, heap_bin(bracket()), np.random.default_rng(0))
        assert result.estimates == []


def test_a_heap_of_clutter_is_not_believed() -> None:
    """Smooth hills in place of workpieces: whatever is found is not believed."""
    frame = seen(0)[0]
    v, u = np.mgrid[: frame.depth.shape[0], : frame.depth.shape[1]]
    hills = 0.83 - 0.012 * (np.sin(u / 40) * np.cos(v / 35) + 1)
    clutter = DepthFrame(hills.astype(np.float32), frame.intrinsics, frame.T_world_camera)
    result = perception().perceive(clutter, heap_bin(bracket()), np.random.default_rng(0))
    assert all(e.score < 0.5 for e in result.estimates)
