"""Pose voting by all votes: the fit is exact on exact votes, robust against wrong ones, and takes symmetry as it is."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pickproof.cell.symmetry.symmetry import Symmetry
from pickproof.perception.ps6d.pose_fitting import FitConfig, fit_categories, fit_pose, kabsch, nearest_copies
from pickproof.perception.ps6d.votes import Votes
from pickproof.perception.ps6d.voting import Categories, Modes

SYMMETRIES = {
    "none": Symmetry(),
    "half turn": Symmetry((0.0, 0.0, 180.0)),
    "quarter turns and flips": Symmetry((180.0, 0.0, 90.0)),
    "revolution": Symmetry((180.0, 0.0, 1.0)),
    "sphere": Symmetry((1.0, 1.0, 1.0)),
}


ASIDE, FAR = np.array([1.5, 0.0, 0.0]), np.array([0.0, 2.0, 0.0])


def some_votes(
    rng: np.random.Generator, R: np.ndarray, t: np.ndarray, symmetry: Symmetry, noise: float, count: int = 300
) -> Votes:
    """Votes of one instance whose coordinates are noisy and of any symmetric copy."""
    cad = rng.uniform(-0.5, 0.5, (count, 3)) * [1.0, 0.6, 0.3]
    copies = symmetry.rotations()[rng.integers(len(symmetry.rotations()), size=count)]
    predicted = np.einsum("nij,nj->ni", copies, cad) + noise * rng.standard_normal((count, 3))
    rotations = np.broadcast_to(R, (count, 3, 3))
    return Votes(cad @ R.T + t, np.broadcast_to(t, (count, 3)), rotations, predicted)


def surface_error(R: np.ndarray, t: np.ndarray, R_true: np.ndarray, t_true: np.ndarray, symmetry: Symmetry) -> float:
    """Largest distance at the box's corners, at the best symmetric copy; of the axis where one is infinite."""
    corners = symmetry.v * [[x, y, z] for x in (-0.5, 0.5) for y in (-0.3, 0.3) for z in (-0.15, 0.15)]
    here = corners @ R.T + t
    return min(float(np.linalg.norm(here - (corners @ (R_true @ s).T + t_true), axis=1).max()) for s in symmetry.S)


@pytest.mark.parametrize("seed", range(5))
def test_kabsch_finds_the_motion_between_two_clouds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    R, t = Rotation.random(rng=seed).as_matrix(), rng.standard_normal(3)
    cloud = rng.standard_normal((40, 3))
    weights = rng.uniform(0.1, 1.0, 40)
    found_R, found_t = kabsch(cloud @ R.T + t, cloud, weights)
    assert np.allclose(found_R, R, atol=1e-12)
    assert np.allclose(found_t, t, atol=1e-12)


@pytest.mark.parametrize("name", SYMMETRIES)
def test_the_nearest_copy_of_a_coordinate_is_a_copy_and_no_other_is_nearer(name: str) -> None:
    symmetry, rng = SYMMETRIES[name], np.random.default_rng(1)
    coordinates, seen = rng.standard_normal((50, 3)), rng.standard_normal((50, 3))
    nearest, distance = nearest_copies(coordinates, seen, symmetry)
    assert np.allclose(np.linalg.norm(nearest, axis=1), np.linalg.norm(coordinates, axis=1))
    assert np.allclose(np.linalg.norm(nearest - seen, axis=1), distance)
    for s in symmetry.rotations(48):
        assert (distance <= np.linalg.norm(coordinates @ s.T - seen, axis=1) + 1e-9).all()


@pytest.mark.parametrize("name", SYMMETRIES)
@pytest.mark.parametrize("seed", range(4))
def test_a_fit_of_noisy_votes_is_nearer_than_the_votes_and_than_the_guess(name: str, seed: int) -> None:
    symmetry, rng = SYMMETRIES[name], np.random.default_rng(seed)
    R, t = Rotation.random(rng=seed).as_matrix(), rng.standard_normal(3)
    votes = some_votes(rng, R, t, symmetry, noise=0.01)
    guess_R = R @ Rotation.from_rotvec(np.deg2rad(4) * np.array([0.6, -0.8, 0.0])).as_matrix()
    guess_t = t + 0.02
    found_R, found_t = fit_pose(votes, guess_R, guess_t, symmetry)
    error = surface_error(found_R, found_t, R, t, symmetry)
    assert error < 0.008  # below the error of one vote
    assert error < 0.2 * surface_error(guess_R, guess_t, R, t, symmetry)


def test_a_third_of_wrong_votes_does_not_move_the_fit() -> None:
    rng = np.random.default_rng(3)
    R, t = Rotation.random(rng=3).as_matrix(), np.array([0.1, 0.2, 5.0])
    votes = some_votes(rng, R, t, Symmetry(), noise=0.005)
    assert votes.cad_coordinates is not None
    votes.cad_coordinates[::3] += 0.4
    found_R, found_t = fit_pose(votes, R, t + 0.03, Symmetry())
    assert surface_error(found_R, found_t, R, t, Symmetry()) < 0.01


def test_one_instance_split_in_two_categories_is_one_again_and_a_sliver_is_left_out() -> None:
    rng = np.random.default_rng(4)
    R, t = Rotation.random(rng=4).as_matrix(), np.array([0.0, 0.0, 4.0])
    first = some_votes(rng, R, t, Symmetry(), 0.005)
    second = some_votes(rng, R, t + ASIDE, Symmetry(), 0.005)
    sliver = some_votes(rng, R, t + FAR, Symmetry(), 0.005, count=20)
    parts = (first.select(np.arange(200)), first.select(np.arange(200, 300)), second, sliver)
    columns = [[getattr(p, name) for p in parts] for name in ("points", "centres", "rotations", "cad_coordinates")]
    votes = Votes(*(np.concatenate(column) for column in columns))
    labels = np.repeat([0, 1, 2, 3], [len(p) for p in parts])
    counts = np.array([len(p) for p in parts])
    positions = np.array([t + 0.02, t - 0.02, t + ASIDE, t + FAR])
    modes = Modes(positions, np.stack([R] * 4), counts, labels)
    categories = Categories(positions, modes.rotations, counts, np.zeros(4), np.arange(4))
    found = fit_categories(votes, modes, categories, Symmetry(), FitConfig.model_validate({}))
    assert len(found.counts) == 2
    order = np.argsort(found.positions[:, 0])
    assert np.allclose(found.positions[order], [t, t + ASIDE], atol=0.002)
    assert (found.counts > 250).all()
    assert (found.errors < 0.02).all()


def test_no_votes_are_no_poses() -> None:
    none = Votes(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)))
    found = fit_categories(none, Modes.none(0), Categories.none(), Symmetry(), FitConfig.model_validate({}))
    assert len(found.counts) == 0


def test_votes_without_coordinates_are_refused() -> None:
    votes = Votes(np.zeros((1, 3)), np.zeros((1, 3)), np.eye(3)[None])
    with pytest.raises(ValueError, match="CAD coordinates"):
        fit_categories(votes, Modes.none(1), Categories.none(), Symmetry(), FitConfig.model_validate({}))
