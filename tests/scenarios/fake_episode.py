"""An episode without physics, importable by name in worker processes: the campaign takes its runner as an argument.

The gripper of the scenario says how it misbehaves: `slow`, `dies`, `dies_once:FILE`, `killed:FILE`, `hangs`, `broken`,
`buggy`, or `dies_at_once`, before the first attempt ...
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from pickproof.cell.errors import InputError, SimulationError
from pickproof.scenarios.campaign.job import Job
from pickproof.scenarios.results.records import AttemptRecord, EpisodeRecord, Reason

GRASPS = ("long_side", "flange", "step")


def run_episode(job: Job, on_attempt: Callable[[AttemptRecord], None]) -> EpisodeRecord:
    scenario, seed = job.scenario, job.seed
    rng = np.random.default_rng(seed)
    if scenario.gripper == "dies_at_once":
        raise SimulationError("a workpiece is at infinity")
    left, attempt = scenario.count, 0
    while left > 0 and attempt < scenario.stop.attempt_limit:
        if attempt == 2:
            misbehave(scenario.gripper)
        if scenario.gripper == "slow":
            time.sleep(0.1)
        record = fake_attempt(seed, attempt, left, scenario.count, rng, job.pictures)
        left -= record.success
        attempt += 1
        on_attempt(record)
    end = "cleared" if left == 0 else "stopped"
    return EpisodeRecord(seed, scenario.count, scenario.count - left, end, attempt, time.perf_counter())


def fake_attempt(
    seed: int, attempt: int, left: int, count: int, rng: np.random.Generator, pictures: bool
) -> AttemptRecord:
    poses = rng.standard_normal((count, 7))
    draw = rng.random()
    if draw < 0.05:
        return AttemptRecord(
            seed, attempt, False, False, Reason.ALL_GRASPS_BLOCKED, left, 3, sensing_s=0.4, perceive_s=0.5,
            part_poses_after=poses,
        )  # fmt: skip
    success = draw < 0.9
    reason = "" if success else str(rng.choice(["missed", "slipped", "slipped", "collision"]))
    return AttemptRecord(
        seed=seed,
        attempt=attempt,
        moved=True,
        success=success,
        reason=reason,
        parts_in_bin_before=left,
        n_estimates=int(rng.integers(1, 12)),
        estimate_T_world_part=rng.standard_normal((4, 4)),
        estimate_score=rng.random(),
        error_mm=rng.exponential(0.3),
        error_deg=rng.exponential(0.5),
        grasp=str(rng.choice(GRASPS)),
        sensing_s=0.4,
        perceive_s=time.perf_counter() % 1,  # times may differ, the record hash must not
        choose_s=0.02,
        plan_s=0.2,
        robot_s=2.4,
        part_poses_after=poses,
        tree=[{"estimate": 0, "grasps": [{"grasp": "step", "reason": "jaw in wall"}]}],
        pictures={"depth": b"\x89PNG not really"} if pictures else {},
        wall_s=1.0,
    )


def misbehave(how: str) -> None:
    kind, _, file = how.partition(":")
    if kind == "killed":  # twice, from outside
        marks = [Path(f"{file}.{i}") for i in range(2)]
        if missing := [mark for mark in marks if not mark.exists()]:
            missing[0].touch()
            os.kill(os.getpid(), signal.SIGKILL)
    if kind == "dies_once" and not Path(file).exists():
        Path(file).touch()
        kind = "dies"
    if kind == "dies":
        os.kill(os.getpid(), signal.SIGSEGV)
    if kind == "hangs":
        time.sleep(3600)
    if kind == "broken":
        raise SimulationError("a workpiece is at infinity")
    if kind == "buggy":
        raise ValueError("no such thing as a free lunch")
    if kind == "bad_input":
        raise InputError("weights.safetensors", "hash", "0000", "what `pickproof train bracket` wrote")
