"""The steps of one pick: capture, perceive, choose, decide, execute, judge, remember, record."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pickproof.cell.clock import working_time
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.scenarios.picking.attempt_record import AttemptKey, attempt_record
from pickproof.scenarios.picking.episode_state import EpisodeState
from pickproof.scenarios.picking.execution import execute_pick
from pickproof.scenarios.picking.grasp_selection import choose
from pickproof.scenarios.picking.outcome import Outcome, judge_pick
from pickproof.scenarios.picking.plan_selection import decide
from pickproof.scenarios.picking.recorder import NO_RECORDER, AttemptRecorder
from pickproof.scenarios.picking.snapshots import AttemptPictures
from pickproof.scenarios.picking.stages import ComputeTimes, Considered, Estimates
from pickproof.scenarios.picking.workcell import Workcell
from pickproof.scenarios.results.records import AttemptRecord

PICTURED = 2
"""Number of attempts of an episode with pictures of every stage; failures always get pictures at the end."""
SENSING_STREAM, WRIST_STREAM = 1, 2
"""Random streams of an attempt: one for the camera and the steps after it, one for the wrist sensor."""
Perceive = Callable[[Workcell, DepthFrame, np.ndarray, np.random.Generator], Estimates]
"""Frame and true instance ids to estimates: PS6D, a search, or the perception oracle, which alone reads the ids."""


def attempt_pick(
    cell: Workcell,
    perceive: Perceive,
    state: EpisodeState,
    seed: int,
    attempt: int,
    recorder: AttemptRecorder = NO_RECORDER,
) -> AttemptRecord:
    """One attempt, from the depth image to the judged outcome.

    Args:
        perceive: finds the poses.
        state: what the cell remembers between attempts; it is changed.
        seed: of the episode; attempt: index in it, from 0.
        recorder: writes the attempt's replay file, where one is wanted.
    """
    begun = time.perf_counter()
    rng = np.random.default_rng((seed, SENSING_STREAM, attempt))
    pictures = AttemptPictures(cell, every_stage=attempt < PICTURED)
    before = cell.observe()  # ground truth, for the judge and the record alone
    recorder.start()

    frame, ids = cell.capture(rng)
    captured = working_time()
    estimates = perceive(cell, frame, ids, rng)
    perceived = working_time()
    selection = choose(cell, frame, estimates, state, attempt)  # all grasps: ranked, or why ruled out
    chosen = working_time()
    decision = decide(cell, frame, selection, state, seed=int(rng.integers(2**31)))  # the best with a whole motion
    times = ComputeTimes(perceived - captured, chosen - perceived, working_time() - chosen)
    considered = Considered(before, frame, estimates, selection, decision, times)

    if decision.pick is None:
        outcome = Outcome(decision.reason, after=cell.observe())
        state.remember_no_pick(decision)
    else:
        wrist_rng = np.random.default_rng((seed, WRIST_STREAM, attempt))
        executed = execute_pick(cell, state.place, considered, pictures, wrist_rng)
        outcome = judge_pick(cell, state.place, executed)
        state.remember_pick(attempt, executed, cell.arm)  # what the cell saw itself, not the verdict

    pictures.finish(considered, outcome.success)
    record = attempt_record(cell, AttemptKey(seed, attempt), considered, outcome, pictures.taken)
    record = replace(record, wall_s=time.perf_counter() - begun)
    recorder.stop(record, considered)
    return record
