"""Episodes in the real physics with a fault planted in one stage, importable by name in worker processes."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from cell.camera import DepthFrame
from cell.frames import make_transform
from cell.workpiece import load_workpiece
from scenarios import episode
from scenarios.pick import Estimates, Perceive
from scenarios.records import AttemptRecord, EpisodeRecord
from scenarios.scenario import Scenario
from scenarios.workcell import Workcell

SHIFT, TURN = 0.004, np.deg2rad(8.0)
"""Standard deviations of the planted error of every estimate, along and about each axis: 4 mm and 8 degrees."""
MOVED = 0.004  # [m] that grasp points are moved


def noisy_perception(
    scenario: Scenario,
    seed: int,
    oracle: frozenset[str],
    on_attempt: Callable[[AttemptRecord], None],
    pictures: bool,
) -> EpisodeRecord:
    """An episode whose perception is off: what PS6D finds is moved before it is handed on. The oracle is not."""
    real = episode.ps6d
    episode.ps6d = lambda workpiece, min_score: _with_error(real(workpiece, min_score))  # type: ignore[assignment]
    try:
        return episode.run_episode(scenario, seed, oracle, on_attempt, pictures)
    finally:
        episode.ps6d = real


def _with_error(perceive: Perceive) -> Perceive:
    def worse(cell: Workcell, frame: DepthFrame, ids: np.ndarray, rng: np.random.Generator) -> Estimates:
        found = perceive(cell, frame, ids, rng)
        k = len(found.scores)
        turns = Rotation.from_rotvec(rng.normal(0.0, TURN, (k, 3))).as_matrix()
        errors = make_transform(turns, rng.normal(0.0, SHIFT, (k, 3)))
        return Estimates(found.Ts_world_part @ errors, found.scores, found.residuals)

    return worse


def move_grasps(folder: Path, names: tuple[str, ...]) -> Path:
    """A copy of the bracket in `folder` with these grasp points MOVED along their closing direction.

    The search path of workpieces is PICKPROOF_WORKPIECES: set it to `folder` to use the copy.
    """
    shutil.copytree(load_workpiece("bracket").folder, folder / "bracket")
    path = folder / "bracket" / "grasps.yaml"
    table = yaml.safe_load(path.read_text(encoding="utf-8"))
    for grasp in table["grasps"]:
        if grasp["name"] in names:
            grasp["centre"] = [float(c + MOVED * n) for c, n in zip(grasp["centre"], grasp["closing"], strict=True)]
    path.write_text(yaml.safe_dump(table), encoding="utf-8")
    return path
