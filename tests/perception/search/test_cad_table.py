"""What the search needs of the CAD."""

from __future__ import annotations

import numpy as np
import pytest

from pickproof.cell.symmetry.symmetry import Symmetry
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.perception.cad.shape_model import ShapeModel, fibonacci_sphere
from pickproof.perception.search.cad_table import CadTable, frames_of, octahedral_map, spread_samples
from pickproof.perception.search.config import Density, SearchConfig
from pickproof.perception.search.kernel import _cell
from tests.perception.artificial import bar, rod


def directions(n: int) -> np.ndarray:
    x = np.random.default_rng(0).normal(size=(n, 3))
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def test_frames_are_right_handed_about_their_normal():
    normals = directions(50)
    frames = frames_of(normals).astype(np.float64)
    np.testing.assert_allclose(frames[:, :, 2], normals, atol=1e-6)
    np.testing.assert_allclose(frames.transpose(0, 2, 1) @ frames, np.broadcast_to(np.eye(3), (50, 3, 3)), atol=1e-6)
    assert (np.linalg.det(frames) > 0).all()


def test_the_map_of_directions_names_a_view_about_as_near_as_the_nearest():
    views = fibonacci_sphere(192)
    view_at = octahedral_map(views)
    for d in directions(300):
        nearest, named = (views @ d).max(), views[view_at[_cell(*d.astype(np.float32), len(view_at))]] @ d
        assert np.arccos(named) - np.arccos(nearest) < np.deg2rad(4)


def test_samples_are_apart_and_leave_no_gap():
    shape = ShapeModel.of(load_workpiece("bracket"))
    index = spread_samples(shape.points, shape.normals, shape.symmetry, 0.12)
    places = np.concatenate([shape.points, 0.075 * shape.normals], axis=1)
    distance = np.linalg.norm(places[:, None] - places[None, index], axis=-1)
    assert distance.min(1).max() < 0.12
    between = distance[index] + 9 * np.eye(len(index))
    assert between.min() >= 0.12


def test_both_sides_of_a_thin_wall_are_sampled():
    points = np.array([[0.0, 0, 0.01], [0.0, 0, -0.01]])
    normals = np.array([[0.0, 0, 1], [0.0, 0, -1]])
    assert len(spread_samples(points, normals, Symmetry(), 0.12)) == 2


@pytest.mark.parametrize(("workpiece", "at_most"), [(bar(), 0.45), (rod(), 0.25)])
def test_places_that_symmetry_makes_alike_are_one_sample(workpiece, at_most):
    shape = ShapeModel.of(workpiece)
    alone = spread_samples(shape.points, shape.normals, Symmetry(), 0.12)
    symmetric = spread_samples(shape.points, shape.normals, workpiece.symmetry, 0.12)
    assert 3 <= len(symmetric) < at_most * len(alone)


def test_a_sample_is_seen_from_before_it_and_not_from_behind():
    table = CadTable.of(load_workpiece("bracket"), SearchConfig.model_validate({}))
    views = fibonacci_sphere(192)
    facing = views @ table.frames[:, :, 2].T
    assert not table.seen[facing < 0].any()
    assert table.seen[facing > 0.7].mean() > 0.5
    assert table.seen.any(0).all()


def test_a_longer_part_is_turned_in_finer_steps_and_a_smaller_surface_is_sampled_closer():
    config = SearchConfig.model_validate({})
    plain, slender, flat = (Density.of(load_workpiece(name), config) for name in ("bracket", "ps6d_23", "ps6d_7"))
    assert plain.turns == config.turns
    assert slender.turns > 2 * plain.turns
    assert flat.spacing < config.spacing
