"""Keeps attempts to look at again: watches the cell while they run, and writes those that are worth keeping."""

from __future__ import annotations

from typing import Any

import numpy as np

from pickproof.cell.sensing.camera import DepthFrame
from pickproof.grasping.candidates import Selection
from pickproof.grasping.verdict import CHOSEN, Verdict
from pickproof.scenarios.picking.decision_tree import planning_verdict
from pickproof.scenarios.picking.stages import Decision, Estimates
from pickproof.scenarios.picking.workcell import Workcell
from pickproof.scenarios.results.records import AttemptRecord
from pickproof.scenarios.results.replay_file import Artefact, Motion, matrices_to_poses, path_of, write_artefact
from pickproof.scenarios.results.replay_selection import Keep

EVERY = 10
"""Of an episode's successes the first, the eleventh, ... are kept beside its failures and no-picks."""
PERIOD = 0.02  # [s] between two frames


class Recorder:
    """Watches one cell from fill to end; `start` before an attempt, `stop` after it."""

    def __init__(self, cell: Workcell, keep: Keep) -> None:
        self._cell, self._keep = cell, keep
        self._successes = 0
        self._frames: list[tuple[float, np.ndarray, float, np.ndarray]] = []
        self._steps, self._next = 0, np.inf
        cell.world.after_step.append(self._watch)

    def start(self) -> None:
        """Begin an attempt."""
        self._frames.clear()
        self._steps, self._next = -1, 0.0
        self._watch()

    def stop(
        self, record: AttemptRecord, frame: DepthFrame, estimates: Estimates, selection: Selection, decision: Decision
    ) -> None:
        """End an attempt, and write it if it is one to keep.

        Raises:
            StoreError: it cannot be written.
        """
        self._next = np.inf
        nth, self._successes = self._successes, self._successes + record.success
        if self._keep.which == "failures" and record.success and nth % EVERY:
            return
        cell = self._cell
        time, q, opening, poses = zip(*self._frames, strict=True)
        k, poses_of = len(estimates.scores), cell.grasps
        artefact = Artefact(
            seed=record.seed,
            attempt=record.attempt,
            carrier="gantry" if "motion" in cell.oracle else "arm",
            depth=frame.depth,
            intrinsics=frame.intrinsics,
            T_world_camera=frame.T_world_camera,
            Ts_world_estimate=estimates.Ts_world_part,
            scores=estimates.scores,
            residuals=estimates.residuals,
            Ts_part_tool=poses_of.Ts_part_tool,
            grasps=np.array([poses_of.points[i].name for i in poses_of.index], dtype=str),
            openings=poses_of.openings,
            verdicts=np.array([selection.verdicts[i] for i in range(k)], dtype=str).reshape(k, len(poses_of.index)),
            candidates=candidates_of(selection, decision, {box.name for box in cell.gripper.boxes(0.0)}),
            motion=Motion(np.array(time), np.stack(q), np.array(opening), np.stack(poses)),
        )
        write_artefact(path_of(self._keep.directory, record.seed, record.attempt), artefact)

    def _watch(self) -> None:
        world, arm = self._cell.world, self._cell.arm
        self._steps += 1  # World.time stands still while several steps are asked for at once
        time = self._steps * world.dt
        if time < self._next - world.dt / 2:
            return
        self._next += PERIOD
        self._frames.append((time, arm.q, arm.opening, matrices_to_poses(world.part_poses())))


def candidates_of(selection: Selection, decision: Decision, tool: set[str]) -> list[dict[str, Any]]:
    """The ranked candidates with their poses and what planning made of each, best first."""
    rows = []
    for i, c in enumerate(selection.candidates):
        refused = decision.refused.get(i)
        verdict = str(Verdict.OUTRANKED if refused is None else planning_verdict(refused, tool))
        rows.append(
            {
                "estimate": c.estimate,
                "grasp": c.point.name,
                "T_world_tool": c.T_world_tool,
                "opening": c.opening,
                "rank": round(c.rank, 4),
                "terms": {name: round(value, 3) for name, value in c.terms.items()},
                "verdict": CHOSEN if c is decision.candidate else verdict,
                "detail": "" if refused is None else str(refused),
            }
        )
    return rows
