"""Whole episodes in the physics: small bins, nothing replaced."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import pytest

from pickproof.scenarios.campaign.episode import run_episode
from pickproof.scenarios.campaign.job import Job
from pickproof.scenarios.config.scenario import load_scenario
from pickproof.scenarios.results.record_hash import record_hash
from pickproof.scenarios.results.records import NO_PICK_REASONS, AttemptRecord, EpisodeRecord

pytestmark = pytest.mark.slow

ORACLE = frozenset({"perception"})


@dataclass(frozen=True)
class Run:
    episode: EpisodeRecord
    attempts: list[AttemptRecord]


def run(seed: int, oracle: frozenset[str] = ORACLE, pictures: bool = False, **fields: object) -> Run:
    scenario = load_scenario("bracket", [f"{name}={value}" for name, value in fields.items()])
    attempts: list[AttemptRecord] = []
    episode = run_episode(Job(scenario, seed, oracle, pictures), attempts.append)
    return Run(episode, attempts)


@pytest.fixture(scope="module")
def four() -> Run:
    return run(seed=11, count=4)


def test_the_oracle_clears_a_small_bin(four: Run) -> None:
    assert four.episode.end == "cleared"
    assert four.episode.parts_picked == four.episode.parts_dropped == 4
    assert all(a.success for a in four.attempts if a.moved)


def test_records_are_consistent(four: Run) -> None:
    assert four.episode.attempts == len(four.attempts)
    assert four.episode.parts_picked == sum(a.success for a in four.attempts)
    left = four.episode.parts_dropped
    for i, a in enumerate(four.attempts):
        assert (a.seed, a.attempt) == (11, i)
        assert a.parts_in_bin_before == left
        left -= a.success
        assert a.moved == (a.reason not in NO_PICK_REASONS)
        assert a.success == (a.reason == "")
        assert a.pictures == {}
        assert np.asarray(a.part_poses_after).shape == (4, 7)
        np.testing.assert_allclose(np.linalg.norm(np.asarray(a.part_poses_after)[:, 3:], axis=1), 1, atol=1e-9)
        assert a.sensing_s == load_scenario("bracket").camera.sensing_time_s
        if a.moved:
            assert a.error_mm is not None and a.error_mm < 1e-3  # the oracle is exact
            assert a.robot_s > 0.5
            assert a.place_mm is not None and a.place_mm < 60.0  # it may tumble, but stays about its slot
            assert a.place_deg is not None and 0 <= a.place_deg <= 180
            assert np.asarray(a.estimate_T_world_part).shape == (4, 4)


def test_the_tree_says_what_was_considered_and_what_was_chosen(four: Run) -> None:
    for a in four.attempts:
        assert len(a.tree) == a.n_estimates
        chosen = [c for e in a.tree for c in e["candidates"] if c["verdict"] == "chosen"]
        assert [c["grasp"] for c in chosen] == ([a.grasp] if a.moved else [])
        for estimate in a.tree:
            assert estimate["candidates"] or estimate["ruled_out"]


def test_every_picked_part_lies_in_the_place_bin_at_the_end(four: Run) -> None:
    place = load_scenario("bracket").place_bin.build("place")
    at_the_end = np.asarray(four.attempts[-1].part_poses_after)[:, :3]
    assert place.contains(at_the_end).all()


def test_the_same_seed_gives_the_same_records_and_another_does_not(four: Run) -> None:
    again, other = run(seed=11, count=4), run(seed=12, count=1)
    assert record_hash(four.attempts, [four.episode]) == record_hash(again.attempts, [again.episode])
    assert [a.tree for a in four.attempts] == [a.tree for a in again.attempts]
    assert record_hash(four.attempts, [four.episode]) != record_hash(other.attempts, [other.episode])


def test_stop_rules_end_an_episode() -> None:
    limited = run(seed=11, count=2, **{"stop.attempt_limit": 1})
    assert (limited.episode.end, limited.episode.attempts) == ("stopped", 1)
    # no attempt can be as quick as that
    hopeless = run(seed=11, count=2, **{"limits.attempt_timeout_s": 0.01, "stop.failures_in_a_row": 1})
    assert hopeless.episode.end == "stopped"
    assert hopeless.episode.parts_picked == 0
    assert [str(a.reason) for a in hopeless.attempts] == ["timeout"]


def test_a_bin_that_cannot_be_reached_is_stuck() -> None:
    far = run(
        seed=3,
        count=1,
        **{
            "source_bin": "{position: [0.95, 0.3, 0.01]}",
            "camera.eye": "[0.95, 0.3, 0.86]",
            "camera.target": "[0.95, 0.3, 0.01]",
            "table.size": "[3.0, 3.0, 0.05]",
        },
    )
    assert far.episode.end == "stuck"
    assert {str(a.reason) for a in far.attempts} == {"unreachable"}
    assert not any(a.moved for a in far.attempts)
    verdicts = {c["verdict"] for a in far.attempts for e in a.tree for c in e["candidates"]}
    assert verdicts == {"no_ik"}


def test_ps6d_finds_and_picks_real_parts() -> None:
    """The shipped weights, three workpieces: every estimate that is acted on is within tolerance."""
    found = run(seed=0, oracle=frozenset(), count=3)
    tolerance_mm = 5.0  # of the bracket's workpiece.yaml
    moved = [a for a in found.attempts if a.moved]
    assert len(moved) >= 3
    for a in moved:
        assert a.error_mm is not None and a.error_mm < tolerance_mm
        assert a.estimate_score is not None and 0.5 <= a.estimate_score <= 1
    assert found.episode.parts_picked >= 2


def test_pictures_are_images_of_each_stage() -> None:
    pictured = run(seed=11, count=1, pictures=True)
    pictures = pictured.attempts[0].pictures
    assert set(pictures) == {"depth", "grasp", "lift", "place"}
    camera = load_scenario("bracket").camera
    for name, png in pictures.items():
        image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
        assert image is not None, name
        assert image.std() > 5, name  # not one colour
        if name == "depth":
            assert image.shape == (camera.height, camera.width, 3)
