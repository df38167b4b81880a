from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pickproof.cell.errors import InputError
from pickproof.cell.frames import apply, invert
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.perception.data.scenes import (
    HELD_OUT_SEED,
    TRAIN_SEED,
    VALIDATION_SEED,
    View,
    heap_bin,
    heap_fingerprint,
    load_heaps,
    overhead_view,
    random_view,
    render_heap,
    settle_heap,
)
from tests.perception.small_heaps import bracket, small_heaps


def test_a_seed_is_a_heap() -> None:
    fewer = replace(bracket(), heap=bracket().heap.model_copy(update={"count": (8, 12)}))
    np.testing.assert_array_equal(settle_heap(fewer, 1), small_heaps()[1])
    assert len({float(heap[0, 0, 3]) for heap in small_heaps()}) == 3


def test_heaps_lie_in_their_bin() -> None:
    bin = heap_bin(bracket())
    for heap in small_heaps():
        assert 6 <= len(heap) <= 12
        corners = apply(invert(bin.T_world_bin) @ heap, bracket().vertices)
        assert corners[..., 2].min() > -0.001
        assert np.abs(corners[..., 0]).max() < bin.inner[0] / 2 + 0.001
        assert np.abs(corners[..., 1]).max() < bin.inner[1] / 2 + 0.001


def test_the_three_sets_of_seeds_do_not_meet() -> None:
    starts = sorted([TRAIN_SEED, VALIDATION_SEED, HELD_OUT_SEED])
    assert min(np.diff(starts)) > 100_000  # heaps of one set that would have to be settled to reach the next


def sees_the_whole_bin(view: View) -> bool:
    lx, ly, _ = heap_bin(bracket()).inner
    corners = np.array([[i * lx / 2, j * ly / 2, 0.0] for i in (-1, 1) for j in (-1, 1)])
    T = invert(view.T_world_camera) @ heap_bin(bracket()).T_world_bin
    uv = view.intrinsics.project(apply(T, corners))
    return bool((uv > 0).all() and (uv < (view.intrinsics.width - 1, view.intrinsics.height - 1)).all())


def test_every_view_sees_the_whole_bin_from_above() -> None:
    rng = np.random.default_rng(0)
    views = [overhead_view(bracket()), *(random_view(bracket(), rng) for _ in range(200))]
    seen = [sees_the_whole_bin(v) for v in views]
    assert seen[0]
    assert np.mean(seen) > 0.9  # tilt may cut a corner of the far side off
    for view in views:
        assert view.T_world_camera[2, 2] < -np.cos(np.deg2rad(20.5))
        np.testing.assert_allclose(np.linalg.det(view.T_world_camera[:3, :3]), 1, atol=1e-9)
    millimetres = [1000 * v.T_world_camera[2, 3] / v.intrinsics.fx for v in views]
    assert 0.4 < min(millimetres) < max(millimetres) < 1.1  # of a pixel


def test_the_ids_are_those_of_the_heap() -> None:
    view = overhead_view(bracket())
    exact = render_heap(bracket(), small_heaps()[0], view)
    assert set(np.unique(exact.ids)) <= set(range(-1, len(small_heaps()[0])))
    centres = view.intrinsics.project(apply(invert(view.T_world_camera), small_heaps()[0][:, :3, 3]))
    for i in np.unique(exact.ids[exact.ids >= 0]):
        v, u = np.nonzero(exact.ids == i)
        assert np.hypot(u.mean() - centres[i, 0], v.mean() - centres[i, 1]) < 60


@pytest.mark.slow
def test_stored_heaps_are_read_and_missing_ones_are_settled(tmp_path: Path) -> None:
    """Seeds 5 and 6 are stored, 7 is not."""
    folder, ticks = tmp_path / "heaps", list[int]()
    folder.mkdir()
    path = folder / "heaps-bracket-5.npz"
    made_of = np.array(heap_fingerprint(bracket()))
    np.savez_compressed(path, **{"5": small_heaps()[0], "6": small_heaps()[1], "fingerprint": made_of})
    a, b, c = load_heaps(bracket(), 5, 3, folder, 1, ticks.append)
    np.testing.assert_array_equal(a, small_heaps()[0])
    np.testing.assert_array_equal(b, small_heaps()[1])
    np.testing.assert_array_equal(c, settle_heap(bracket(), 7))
    assert ticks == [2, 3]
    assert [p.name for p in folder.iterdir()] == [path.name]
    again = load_heaps(bracket(), 5, 3, folder, 1)  # all stored now
    for x, y in zip(again, (a, b, c), strict=True):
        np.testing.assert_array_equal(x, y)
    assert len(load_heaps(bracket(), 5, 2, folder, 1)) == 2


@pytest.mark.slow
def test_heaps_of_a_workpiece_that_has_changed_are_settled_anew(tmp_path: Path) -> None:
    stale = small_heaps()[0] + 1.0
    np.savez_compressed(tmp_path / "heaps-bracket-5.npz", **{"5": stale, "fingerprint": np.array("of a lighter part")})
    (poses,) = load_heaps(bracket(), 5, 1, tmp_path, 1)
    np.testing.assert_array_equal(poses, settle_heap(bracket(), 5))
    heavier = replace(bracket(), mass=2 * bracket().mass)
    toothed = replace(bracket(), rolling_friction=0.004)  # a part that rolls comes to rest elsewhere without its teeth
    own = heap_fingerprint(bracket())
    assert len({own, heap_fingerprint(heavier), heap_fingerprint(toothed)}) == 3
    assert own == heap_fingerprint(load_workpiece("bracket"))


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 not a zip", b"name: bracket\n", b"\x93NUMPY"])
def test_a_broken_heaps_file_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "heaps-bracket-5.npz"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"heaps-bracket-5\.npz.*delete it"):
        load_heaps(bracket(), 5, 1, tmp_path, 1)


def test_a_truncated_heaps_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "heaps-bracket-5.npz"
    np.savez_compressed(path, **{"5": small_heaps()[0]})
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(InputError, match=r"heaps-bracket-5\.npz"):
        load_heaps(bracket(), 5, 1, tmp_path, 1)
