"""What an evaluation says about instances, poses and pictures."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pickproof.cell.frames import Array, make_transform
from pickproof.cell.sensing.camera import DepthFrame, Intrinsics
from pickproof.cell.symmetry.symmetry import Symmetry
from pickproof.perception.data.overlay import (
    LEGEND,
    MISSED,
    SMALL,
    WRONG,
    Pictured,
    draw_frame,
    draw_legend,
    error_colour,
)
from pickproof.perception.evaluation.analysis import (
    Instances,
    distances,
    instances_of,
    recall_by_visibility,
    right_poses,
)
from pickproof.perception.evaluation.metrics import score_frame
from tests.perception.small_heaps import bracket

POINTS = bracket().sample_surface(200)[0]
TRUTH = make_transform(t=[[0.0, 0, 0.5], [0.1, 0, 0.5], [0.0, 0.1, 0.5]])
VISIBILITY = np.array([1.0, 0.5, 0.25])
COUNTED = VISIBILITY > 0.4


def moved(*shifts: tuple[float, float, float]) -> Array:
    """TRUTH[0] shifted."""
    return make_transform(t=TRUTH[0, :3, 3] + np.array(shifts))


def instances(Ts_pred: Array) -> Instances:
    D = distances(Ts_pred, TRUTH, POINTS, bracket().symmetry)
    matched = score_frame(Ts_pred, TRUTH, COUNTED, bracket(), points=POINTS).matched
    return instances_of(7, VISIBILITY, COUNTED, matched, D, Ts_pred, TRUTH, bracket().symmetry)


def test_distance_of_a_shift_is_the_shift() -> None:
    D = distances(moved((0.003, 0, 0), (0, 0.004, 0)), TRUTH, POINTS, bracket().symmetry)
    assert D.shape == (2, 3)
    assert D[:, 0] == pytest.approx([0.003, 0.004])
    assert D[0, 1] == pytest.approx(0.097)
    assert distances(np.zeros((0, 4, 4)), TRUTH, POINTS, bracket().symmetry).shape == (0, 3)
    assert distances(TRUTH, np.zeros((0, 4, 4)), POINTS, bracket().symmetry).shape == (3, 0)


def test_each_instance_gets_its_nearest_prediction() -> None:
    found = instances(moved((0.001, 0, 0), (0.1, 0.02, 0)))
    assert found.found.tolist() == [True, False, False]
    assert found.distance[:2] == pytest.approx([0.001, 0.02])
    assert found.translation[:2] == pytest.approx([0.001, 0.02])
    assert found.rotation == pytest.approx(0, abs=1e-6)
    none = instances(np.zeros((0, 4, 4)))
    assert not none.found.any() and np.isnan(none.distance).all()


def test_recall_by_visibility_counts_every_instance_once() -> None:
    both = Instances.join([instances(TRUTH[:2]), instances(np.zeros((0, 4, 4)))])
    rows = recall_by_visibility(both, bins=4)
    assert [row["count"] for row in rows] == [0, 2, 2, 2]
    assert [row["found"] for row in rows] == [0, 0, 1, 1]
    assert [row["recall"] for row in rows] == [None, 0, 50, 50]


def test_csv_holds_the_instances(tmp_path: Path) -> None:
    instances(moved((0.001, 0, 0))).save(tmp_path / "instances.csv")
    with (tmp_path / "instances.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["visibility"]) for row in rows] == VISIBILITY.tolist()
    assert [row["found"] for row in rows] == ["True", "False", "False"]
    assert float(rows[0]["distance"]) == pytest.approx(0.001)


@pytest.mark.parametrize("symmetry", [Symmetry((0, 0, 0)), Symmetry((0, 0, 180)), Symmetry((0, 0, 1))])
def test_right_poses_are_those_within_tolerance_of_any_instance(symmetry: Symmetry) -> None:
    part = replace(bracket(), symmetry=symmetry)
    rng = np.random.default_rng(0)
    near = TRUTH[rng.integers(3, size=60)]
    turns = make_transform(Symmetry((0, 0, 90)).S[rng.integers(4, size=60)])
    Ts = near @ turns @ make_transform(t=rng.normal(0, 0.0025, (60, 3)))
    right = right_poses(Ts, TRUTH, POINTS, part)
    assert right.tolist() == (distances(Ts, TRUTH, POINTS, symmetry).min(1) < part.tolerance).tolist()
    assert 3 < right.sum() < 57
    assert not right_poses(Ts, np.zeros((0, 4, 4)), POINTS, part).any()


def pictured(Ts_pred: Array) -> Pictured:
    camera = Intrinsics.from_fov(320, 240, 0.6)
    frame = DepthFrame(np.full((240, 320), 0.6, np.float32), camera, np.eye(4))
    score = score_frame(Ts_pred, TRUTH, COUNTED, bracket(), points=POINTS)
    errors = distances(Ts_pred, TRUTH, POINTS, bracket().symmetry).min(1, initial=np.inf)
    return Pictured(frame, TRUTH, COUNTED, Ts_pred, score.matched, errors)


def drawn(image: np.ndarray, colour: tuple[int, int, int]) -> int:
    """Pixels of a colour, borders of anti-aliased lines left out."""
    return int((np.abs(image.astype(int) - colour).max(-1) < 12).sum())


def test_picture_marks_missed_and_wrong() -> None:
    right = draw_frame(pictured(TRUTH[:2]), bracket())
    assert right.shape == (240, 320, 3)
    assert drawn(right, MISSED) == drawn(right, WRONG) == 0
    assert drawn(right, error_colour(0)) > 200
    missed = pictured(moved((0, 0, 0), (0.0, 0.03, 0)))
    assert missed.missed.tolist() == [False, True, False]  # the third does not count
    image = draw_frame(missed, bracket())
    assert drawn(image, MISSED) > 50 and drawn(image, WRONG) > 100


def test_error_colours_tell_small_from_large() -> None:
    assert error_colour(0) == error_colour(SMALL)
    blues, reds = zip(*[(c[0], c[2]) for c in map(error_colour, (SMALL, 0.1, 0.3, 1))], strict=True)
    assert blues[0] > 200 > 100 > blues[-1] and reds[0] < 100 < 200 < reds[-1]
    assert draw_legend(640, 0.005).shape == (LEGEND, 640, 3)
