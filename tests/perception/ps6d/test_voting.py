"""Clustering: the rotation metric is a length, modes are found, symmetric modes are merged, the vote is a good one."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pickproof.cell.frames import random_rotations, rotation_angle
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.ps6d.votes import Votes
from pickproof.perception.ps6d.voting import ClusterConfig, cluster, find_modes, mean_shift, merge, nearest_rotations
from tests.perception import artificial

pytestmark = pytest.mark.slow


def scattered(R, t, count, rng, angle=0.15, position=0.03):
    """Votes about one pose."""
    turns = Rotation.from_rotvec(rng.normal(0, angle, (count, 3))).as_matrix()
    centres = np.asarray(t) + rng.normal(0, position, (count, 3))
    return Votes(centres, centres, turns @ R)


def together(*votes):
    return Votes(*(np.concatenate([getattr(v, name) for v in votes]) for name in ("points", "centres", "rotations")))


@pytest.fixture(scope="module")
def bracket():
    return ShapeModel.of(load_workpiece("bracket"))


def test_embedded_distance_is_the_rms_distance_of_the_surface(bracket):
    R = random_rotations(40, np.random.default_rng(0))
    embedded = bracket.embed(R)
    for a, b in zip(range(20), range(20, 40), strict=True):
        moved = bracket.points @ (R[a] - R[b]).T
        rms = np.sqrt((moved**2).sum(1).mean())
        assert np.linalg.norm(embedded[a] - embedded[b]) == pytest.approx(rms, rel=1e-9)


def test_turning_a_rod_about_its_axis_is_no_distance():
    shape = ShapeModel.of(artificial.rod())
    R = random_rotations(1, np.random.default_rng(0))[0]
    spin = Rotation.from_rotvec([0, 0, 1.3]).as_matrix()
    assert np.allclose(shape.embed(R), shape.embed(R @ spin))
    assert not np.allclose(shape.embed(R), shape.embed(Rotation.from_rotvec([0.3, 0, 0]).as_matrix() @ R))


def test_chordal_mean_undoes_scaling_and_reflects_never():
    rng = np.random.default_rng(1)
    R = random_rotations(30, rng)
    assert np.allclose(nearest_rotations(2.5 * R), R)
    assert np.allclose(np.linalg.det(nearest_rotations(rng.normal(size=(50, 3, 3)))), 1.0)


def test_mean_shift_finds_the_densest_first_and_moves_with_the_data():
    rng = np.random.default_rng(2)
    data = np.concatenate([rng.normal(0, 0.2, (30, 4)), rng.normal(3, 0.2, (60, 4))])
    peaks = mean_shift(data, 90, 20)
    assert len(peaks) == 2
    assert np.allclose(peaks[0], 3, atol=0.15) and np.allclose(peaks[1], 0, atol=0.15)
    shift = np.array([5.0, -7, 11, 100])
    assert np.allclose(mean_shift(data + shift, 90, 20), peaks + shift, atol=1e-4)


def test_workpieces_that_cross_are_told_apart_by_rotation(bracket):
    rng = np.random.default_rng(3)
    across = Rotation.from_rotvec([0, 0, np.pi / 2]).as_matrix()
    votes = together(scattered(np.eye(3), [0, 0, 15], 40, rng), scattered(across, [0.1, 0, 15], 40, rng))
    modes, categories = cluster(votes, bracket, ClusterConfig())
    assert len(categories.counts) == 2
    assert all(rotation_angle(R.T @ S) < 0.2 for R, S in zip(categories.rotations[:1], modes.rotations, strict=False))
    one = ClusterConfig(rotation_bandwidth=50.0)
    assert len(cluster(votes, bracket, one)[1].counts) == 1


def test_modes_of_a_symmetric_workpiece_become_one_category():
    shape = ShapeModel.of(artificial.bar())
    rng = np.random.default_rng(4)
    R = random_rotations(1, rng)[0]
    S = shape.symmetry.S
    assert len(S) == 4
    votes = together(*(scattered(R @ s, [0.2, 0.1, 14], 25, rng) for s in S))
    modes = find_modes(votes, shape, ClusterConfig())
    assert len(modes.counts) >= 3  # a half turn about the long axis moves little, so two modes may touch
    _, categories = cluster(votes, shape, ClusterConfig())
    assert categories.counts.tolist() == [modes.counts.sum()]
    assert np.linalg.norm(categories.positions[0] - [0.2, 0.1, 14]) < 0.03
    assert min(rotation_angle(categories.rotations[0].T @ R @ s) for s in S) < 0.25
    single = ClusterConfig(two_stage=False)
    assert len(cluster(votes, shape, single)[1].counts) == len(modes.counts)


def test_votes_all_over_are_no_instance(bracket):
    rng = np.random.default_rng(5)
    centres = rng.uniform(-3, 3, (400, 3))
    _, categories = cluster(Votes(centres, centres, random_rotations(400, rng)), bracket, ClusterConfig())
    assert len(categories.counts) == 0


def test_numbering_is_by_votes_and_consistent(bracket):
    rng = np.random.default_rng(6)
    R = random_rotations(3, rng)
    sizes = (10, 50, 30)
    votes = together(*(scattered(R[i], [i, 0, 15], n, rng) for i, n in enumerate(sizes)))
    modes = find_modes(votes, bracket, ClusterConfig())
    assert np.all(np.diff(modes.counts) <= 0)
    assert np.array_equal(np.bincount(modes.labels[modes.labels >= 0], minlength=len(modes.counts)), modes.counts)
    of_mode = merge(modes, modes.positions, ClusterConfig())
    assert of_mode[0] == 0 and np.allclose(modes.positions[0], [1, 0, 15], atol=0.05)
