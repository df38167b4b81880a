"""One episode: a seeded bin fill, attempted until it is cleared or the stop rule ends it."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from pickproof.cell.sensing.camera import DepthFrame
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.scenarios.campaign.job import Job
from pickproof.scenarios.config.scenario import PerceptionConfig
from pickproof.scenarios.picking.cell_model import SOURCE
from pickproof.scenarios.picking.episode_state import EpisodeState
from pickproof.scenarios.picking.pick import Perceive, attempt_pick
from pickproof.scenarios.picking.recorder import AttemptRecorder, recorder_of
from pickproof.scenarios.picking.stages import Estimates
from pickproof.scenarios.picking.workcell import Workcell
from pickproof.scenarios.results.records import AttemptRecord, End, EpisodeRecord, Reason

ORACLE_PIXELS = 150
"""Smallest number of visible pixels of a workpiece that the perception oracle returns."""
NO_PICKS_IN_A_ROW = 3
"""Number of consecutive images without a pick after which a bin counts as stuck."""


def run_episode(job: Job, on_attempt: Callable[[AttemptRecord], None]) -> EpisodeRecord:
    """Fill the bin with the job's seed and pick until the end; each attempt is passed on when it ends."""
    start = time.perf_counter()
    scenario, exact = job.scenario, "perception" in job.oracle
    perceive = oracle_perception if exact else trained_or_search(scenario.workpiece, scenario.perception)
    cell = Workcell.build(scenario, job.seed, job.pictures, job.oracle)
    recorder = recorder_of(cell, job.keep)
    try:
        state = EpisodeState.of(cell)
        picked, attempts, end = _pick_until_end(cell, perceive, state, job.seed, on_attempt, recorder)
    finally:
        cell.close()
    return EpisodeRecord(job.seed, cell.dropped, picked, end, attempts, time.perf_counter() - start)


def _pick_until_end(
    cell: Workcell,
    perceive: Perceive,
    state: EpisodeState,
    seed: int,
    on_attempt: Callable[[AttemptRecord], None],
    recorder: AttemptRecorder,
) -> tuple[int, int, End]:
    """Number of successes, number of attempts and no-picks, and how the episode ended."""
    stop = cell.scenario.stop
    picked = failures = no_picks = attempts = 0
    while attempts < stop.attempt_limit:
        if not cell.observe().parts_in(SOURCE):
            return picked, attempts, "cleared"
        record = attempt_pick(cell, perceive, state, seed, attempts, recorder)
        on_attempt(record)
        attempts += 1
        picked += record.success
        if record.moved:
            failures = 0 if record.success else failures + 1
        no_picks = 0 if record.moved else no_picks + 1
        if no_picks:
            state.failed.clear()  # the avoided workpieces may be the only ones left
        if no_picks >= NO_PICKS_IN_A_ROW:
            return picked, attempts, "stuck"
        if failures >= stop.failures_in_a_row or record.reason == Reason.SIMULATION_ERROR:
            return picked, attempts, "stopped"
    return picked, attempts, "stopped"


def oracle_perception(cell: Workcell, frame: DepthFrame, ids: np.ndarray, rng: np.random.Generator) -> Estimates:
    """Ground truth in place of perception: exact poses of all visible workpieces, scored by visible area."""
    truth = cell.observe()
    pixels = np.array([np.count_nonzero(ids == i) for i in range(len(truth.Ts_world_part))])
    seen = [i for i in truth.parts_in(SOURCE) if pixels[i] >= ORACLE_PIXELS]
    score = np.minimum(pixels[seen] / max(pixels.max(initial=1), 1), 1.0)
    order = np.argsort(-score, kind="stable")[: cell.scenario.perception.max_estimates]
    return Estimates(truth.Ts_world_part[seen][order], score[order], np.zeros(len(order)))


@lru_cache(maxsize=4)
def trained_or_search(workpiece: str, settings: PerceptionConfig) -> Perceive:
    """The scenario's method of perception, loaded once per process."""
    from pickproof.perception.estimate import Perception
    from pickproof.perception.refinement.refine import RefineConfig
    from pickproof.perception.refinement.verify import VerifyConfig

    config = RefineConfig(verify=VerifyConfig(min_score=settings.min_score))
    perception = Perception.load(load_workpiece(workpiece), config=config, method=settings.method)

    def perceive(cell: Workcell, frame: DepthFrame, ids: np.ndarray, rng: np.random.Generator) -> Estimates:
        found = perception.perceive(frame, cell.source, rng).estimates
        good = found[: cell.scenario.perception.max_estimates]
        if not good:
            return Estimates(np.zeros((0, 4, 4)), np.zeros(0), np.zeros(0))
        Ts = frame.T_world_camera @ np.stack([e.T_camera_part for e in good])
        return Estimates(Ts, np.array([e.score for e in good]), np.array([e.residual for e in good]))

    return perceive
