from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from pickproof.cell.sensing.camera import DepthFrame
from pickproof.scenarios.campaign.episode import oracle_perception
from pickproof.scenarios.config.scenario import load_scenario
from pickproof.scenarios.picking.episode_state import EpisodeState
from pickproof.scenarios.picking.grasp_selection import choose
from pickproof.scenarios.picking.snapshots import CHOSEN, OTHERS, TOOL, cell_snapshot, depth_picture, png
from pickproof.scenarios.picking.stages import Estimates
from pickproof.scenarios.picking.workcell import Workcell

NOTHING = Estimates(np.zeros((0, 4, 4)), np.zeros(0), np.zeros(0))


@pytest.fixture(scope="module")
def cell() -> Iterator[Workcell]:
    built = Workcell.build(load_scenario("bracket", ["count=2"]), seed=1, pictures=True)
    yield built
    built.close()


def decoded(data: bytes) -> np.ndarray:
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return image


def share(image: np.ndarray, colour: tuple[int, int, int]) -> float:
    return float((np.abs(image.astype(int) - colour).max(axis=-1) < 30).mean())


def test_png_keeps_every_pixel() -> None:
    image = np.random.default_rng(0).integers(0, 256, (31, 47, 3), dtype=np.uint8)
    np.testing.assert_array_equal(decoded(png(image)), image)


def test_the_depth_picture_shows_poses_and_the_chosen_grasp(cell: Workcell) -> None:
    rng = np.random.default_rng(0)
    frame, ids = cell.capture(rng)
    estimates = oracle_perception(cell, frame, ids, rng)
    selection = choose(cell, frame, estimates, EpisodeState.of(cell), 0)
    chosen = selection.candidates[0]
    plain = decoded(depth_picture(cell, frame, NOTHING, None))
    without, drawn = (decoded(depth_picture(cell, frame, estimates, c)) for c in (None, chosen))
    assert plain.shape == (*frame.depth.shape, 3)
    np.testing.assert_array_equal(plain[..., 0], plain[..., 1])  # grey
    assert (plain[frame.depth == 0] == 0).all()
    assert (plain[frame.depth > 0] > 0).all()
    assert share(without, OTHERS) > 0.001 and share(without, CHOSEN) == share(without, TOOL) == 0
    assert share(drawn, CHOSEN) > 0.001 and share(drawn, TOOL) > 0.0005
    # outlines stand where the workpieces are seen
    near_a_part = cv2.dilate((ids >= 0).astype(np.uint8), np.ones((15, 15), np.uint8)) > 0
    changed = (without != plain).any(axis=-1)
    assert near_a_part[changed].mean() > 0.98


def test_a_blind_camera_still_gives_a_picture(cell: Workcell) -> None:
    frame, _ = cell.capture(np.random.default_rng(0))
    blind = DepthFrame(np.zeros_like(frame.depth), frame.intrinsics, frame.T_world_camera)
    assert (decoded(depth_picture(cell, blind, NOTHING, None)) == 0).all()


def test_a_snapshot_shows_the_cell_as_it_stands(cell: Workcell) -> None:
    shown_before = cell_snapshot(cell)
    q = cell.robot.home.copy()
    cell.arm.reset(q + np.array([0.5, 0, 0, 0, 0, 0]))
    shown_after = cell_snapshot(cell)
    cell.arm.reset(q)
    before, after = (decoded(shown) for shown in (shown_before, shown_after))
    assert before.shape == after.shape == (420, 560, 3)
    assert 0.005 < (np.abs(before.astype(int) - after).max(axis=-1) > 20).mean() < 0.9
