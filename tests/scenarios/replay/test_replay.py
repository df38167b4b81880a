"""One kept attempt, from the physics to the page in a real browser."""

from __future__ import annotations

import shutil
import sqlite3
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from pickproof.cell.errors import InputError
from pickproof.cell.frames import apply, invert
from pickproof.cell.physics.arm import Arm
from pickproof.cell.physics.world import World
from pickproof.cell.sensing.camera import look_at
from pickproof.grasping.verdict import CHOSEN, Verdict
from pickproof.robots.kinematics.links import link_poses, link_shapes
from pickproof.robots.kinematics.model import load_robot
from pickproof.scenarios.campaign.episode import run_episode
from pickproof.scenarios.campaign.job import Job
from pickproof.scenarios.commands.cli import main
from pickproof.scenarios.config.scenario import list_scenarios, load_scenario, scenario_json
from pickproof.scenarios.picking.recorder import PERIOD
from pickproof.scenarios.replay.data import Replayed
from pickproof.scenarios.replay.film import SIZE, looking, pictures, record
from pickproof.scenarios.replay.page import ReplayPage
from pickproof.scenarios.results.replay_file import (
    LENGTH_STEP,
    path_of,
    poses_to_matrices,
    read_artefact,
    write_artefact,
)
from pickproof.scenarios.results.replay_selection import Keep
from pickproof.scenarios.results.store import FILE, Store
from tests.scenarios.browser import CHROMIUM, Browser
from tests.scenarios.reporting.test_report import meta
from tests.scenarios.sockets import listening, on_loopback

pytestmark = pytest.mark.slow

SEED, LIMIT = 5, 300_000


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two brackets picked with the perception oracle, every attempt kept."""
    out = tmp_path_factory.mktemp("kept")
    scenario = load_scenario("bracket", ["count=2"])
    with Store.create(out, meta(scenario=scenario_json(scenario), episodes=1)) as store:
        job = Job(scenario, SEED, frozenset({"perception"}), keep=Keep(out, "all"))
        store.add_episode(run_episode(job, store.add_attempt))
    return out


@pytest.fixture(scope="module")
def shown(campaign: Path) -> Replayed:
    return Replayed.load(campaign, "0")


@pytest.fixture(scope="module")
def page(shown: Replayed) -> Iterator[ReplayPage]:
    built = ReplayPage(shown, port=0)
    yield built
    built.close()


def test_what_is_kept_is_the_attempt(campaign: Path, shown: Replayed) -> None:
    a, r = shown.artefact, shown.record
    assert r.moved and path_of(campaign, SEED, 0).stat().st_size < LIMIT
    assert np.diff(a.motion.time).max() < PERIOD + 2 / 480 and a.motion.time[0] == 0
    assert abs(float(a.motion.time[-1]) - r.robot_s) < 2.5  # it goes on until all is at rest
    last = np.asarray(r.part_poses_after)
    np.testing.assert_allclose(a.motion.poses[-1][:, :3], last[:, :3], atol=2e-4)
    chosen = [c for c in a.candidates if c["verdict"] == CHOSEN]
    assert [c["grasp"] for c in chosen] == [r.grasp]
    T = np.array(r.estimate_T_world_part)
    assert np.abs(a.Ts_world_estimate - T).max(axis=(1, 2)).min() < 1e-6
    at_grasp = np.linalg.norm(shown.Ts_world_tool[:, :3, 3] - chosen[0]["T_world_tool"][:3, 3], axis=1)
    assert at_grasp.min() < 0.003
    assert (shown.errors_mm < 1e-2).all() and not shown.wrong.any()


def test_one_attempt_is_replayed_and_exported_without_reading_another(campaign: Path, tmp_path: Path) -> None:
    shutil.copytree(campaign, tmp_path / "copy")
    with sqlite3.connect(tmp_path / "copy" / FILE) as db:  # whoever decodes another row fails
        db.execute("UPDATE attempts SET tree = 'no JSON', waypoints = 'no JSON' WHERE attempt != 1")
    db.close()
    assert Replayed.load(tmp_path / "copy", "1").record.attempt == 1
    program = tmp_path / "PICK.LS"
    assert main(["export-program", str(tmp_path / "copy"), "--attempt", "1", "--out", str(program)]) == 0
    assert "/PROG" in program.read_text()
    with pytest.raises(ValueError):
        Replayed.load(tmp_path / "copy", "0")


def test_every_grasp_pose_has_a_verdict_or_is_a_candidate(shown: Replayed) -> None:
    a = shown.artefact
    assert a.verdicts.shape == (len(a.scores), len(a.Ts_part_tool))
    assert set(np.unique(a.verdicts)) <= {"", *map(str, Verdict)}
    assert 0 < len(a.candidates) <= np.count_nonzero(a.verdicts == "")


def test_writing_and_reading_changes_nothing_but_the_last_digits(shown: Replayed, tmp_path: Path) -> None:
    a = shown.artefact
    rng = np.random.default_rng(0)
    q = rng.standard_normal((9, 3, 4))
    q /= np.linalg.norm(q, axis=2, keepdims=True)
    poses = np.concatenate([rng.uniform(-2, 2, (9, 3, 3)), q], axis=2)
    motion = replace(a.motion, poses=poses, time=np.arange(9.0), q=np.zeros((9, 6)), opening=np.zeros(9))
    back = read_artefact(write_artefact(tmp_path / "replay" / "1-2.npz", replace(a, motion=motion)))
    np.testing.assert_allclose(back.motion.poses[..., :3], poses[..., :3], atol=LENGTH_STEP)
    np.testing.assert_allclose(poses_to_matrices(back.motion.poses[4])[:, :3, :3],
                               poses_to_matrices(poses[4])[:, :3, :3], atol=2e-4)  # fmt: skip
    np.testing.assert_array_equal(back.verdicts, a.verdicts)
    np.testing.assert_array_equal(back.depth > 0, a.depth > 0)
    np.testing.assert_allclose(back.depth, a.depth, atol=5.1e-5)
    assert [c["verdict"] for c in back.candidates] == [c["verdict"] for c in a.candidates]


@pytest.mark.parametrize("name", list_scenarios())
def test_a_film_shows_both_bins_of_any_cell(name: str) -> None:
    """A cell of 2 m was seen from as near as one of half a metre."""
    scenario = load_scenario(name)
    bins = [scenario.source_bin.build("source"), scenario.place_bin.build("place")]
    eye, target = looking(*bins)
    seen = invert(look_at(np.array(eye), np.array(target), up=(0.0, 0.0, 1.0)))
    steepest = np.tan(np.deg2rad(45.0 / 2))
    for one in bins:
        corners = [[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)]
        x, y, z = apply(seen, apply(one.T_world_bin, np.array(corners) * one.inner)).T
        assert (z > 0).all() and (np.abs(y / z) < steepest).all()
        assert (np.abs(x / z) < steepest * SIZE[0] / SIZE[1]).all()


def test_what_was_not_kept_or_is_damaged_says_so(campaign: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--keep all"):
        read_artefact(path_of(tmp_path, 0, 0))
    with pytest.raises(InputError, match=rf"kept \(SEED-ATTEMPT: {SEED}-0"):
        read_artefact(path_of(campaign, SEED, 99))
    whole = path_of(campaign, SEED, 0).read_bytes()
    (tmp_path / "half.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match="pickproof run"):
        read_artefact(tmp_path / "half.npz")


def test_links_stand_where_the_physics_has_them() -> None:
    """Forward kinematics of the viewer against PyBullet's."""
    robot = load_robot("lrmate200id")
    world = World()
    try:
        from pickproof.cell.grippers.registry import load_gripper

        arm = Arm(world, robot.urdf, robot.joints, load_gripper("jaw_v1"))
        q = robot.home + np.random.default_rng(1).uniform(-0.4, 0.4, 6)
        arm.reset(q)
        index = {name: i for i, name in arm.link_names.items()}
        for name, T in link_poses(robot, q[None]).items():
            if name in index:
                state = world.client.getLinkState(arm.body, index[name], computeForwardKinematics=True)
                np.testing.assert_allclose(T[0, :3, 3], state[4], atol=1e-5)
    finally:
        world.close()
    assert {s.kind for s in link_shapes(robot)} == {"box", "cylinder"}


def test_a_film_shows_that_something_moves(shown: Replayed, tmp_path: Path) -> None:
    last = len(shown.artefact.motion.time) - 1
    (_, first), (at, end) = pictures(shown, np.array([0, last]))
    assert at == pytest.approx(float(shown.artefact.motion.time[-1]))
    changed = (np.abs(first.astype(int) - end).max(axis=2) > 40).mean()
    assert 0.005 < changed < 0.5
    with pytest.raises(InputError, match="--record"):
        record(shown, tmp_path / "film.avi")
    image = cv2.imread(str(record(shown, tmp_path / "strip.png")))
    assert image.shape == (840, 1680, 3)


def test_the_server_listens_on_the_loopback_interface_only(page: ReplayPage) -> None:
    opened = listening()
    assert f"0100007F:{int(page.url.rsplit(':', 1)[1]):04X}" in opened and on_loopback(opened)


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")
def test_the_page_loads_plays_and_answers_without_an_error(page: ReplayPage, tmp_path: Path) -> None:
    with Browser(tmp_path) as browser:
        browser.open(page.url)
        browser.until("document.querySelector('canvas')")
        browser.until("document.body.innerText.includes('Attempt 0') && document.body.innerText.includes('chosen')")
        for text in ("time [s]", "Play", "measured points", "grasps of"):
            assert text in browser.run("document.body.innerText")
        before = page._frame
        browser.run("[...document.querySelectorAll('button')].find(b => b.innerText.trim() === 'Play').click()")
        begun = time.monotonic()
        while page._frame == before and time.monotonic() - begun < 60:
            time.sleep(0.05)
        assert page._frame > before
        picture = cv2.imread(str(browser.picture(tmp_path / "page.png")))
        assert len(np.unique(picture[:, :800].reshape(-1, 3), axis=0)) > 100  # something is drawn
        assert browser.errors == []
        outside = [u for u in browser.requests if not u.startswith((page.url, "data:", "blob:", "ws:", "about:"))]
        assert outside == []
