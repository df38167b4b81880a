"""Records attempts for replay: samples the cell while they run, and writes the selected ones."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from pickproof.scenarios.picking.decision_tree import candidate_verdicts, rounded_terms
from pickproof.scenarios.picking.stages import Considered
from pickproof.scenarios.picking.workcell import Workcell
from pickproof.scenarios.results.records import AttemptRecord
from pickproof.scenarios.results.replay_file import Artefact, Motion, matrices_to_poses, path_of, write_artefact
from pickproof.scenarios.results.replay_selection import Keep

EVERY = 10
"""Every 10th success of an episode, from the first, is stored besides its failures and no-picks."""
PERIOD = 0.02  # [s] between two frames


class AttemptRecorder(Protocol):
    """Interface of a recorder: `start` before an attempt, `stop` after it."""

    def start(self) -> None:
        """Begin an attempt."""
        ...

    def stop(self, record: AttemptRecord, considered: Considered) -> None:
        """End an attempt."""
        ...


class NoRecorder:
    """Keeps nothing."""

    def start(self) -> None:
        """See `AttemptRecorder.start`."""
        return

    def stop(self, record: AttemptRecord, considered: Considered) -> None:
        """See `AttemptRecorder.stop`."""
        return


NO_RECORDER = NoRecorder()


def recorder_of(cell: Workcell, keep: Keep | None) -> AttemptRecorder:
    """The recorder of an episode."""
    return NO_RECORDER if keep is None or keep.which == "none" else Recorder(cell, keep)


class Recorder:
    """Records one cell from fill to end, and writes the selected attempts."""

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

    def stop(self, record: AttemptRecord, considered: Considered) -> None:
        """End an attempt, and write it if it is selected.

        Raises:
            StoreError: it cannot be written.
        """
        self._next = np.inf
        nth, self._successes = self._successes, self._successes + record.success
        if self._keep.which == "failures" and record.success and nth % EVERY:
            return
        path = path_of(self._keep.directory, record.seed, record.attempt)
        write_artefact(path, self._artefact(record, considered))

    def _artefact(self, record: AttemptRecord, considered: Considered) -> Artefact:
        cell, frame, estimates = self._cell, considered.frame, considered.estimates
        time, q, opening, poses = zip(*self._frames, strict=True)
        k, grasps, verdicts = len(estimates.scores), cell.grasps, considered.selection.verdicts
        return Artefact(
            seed=record.seed,
            attempt=record.attempt,
            carrier=cell.carrier.name,
            depth=frame.depth,
            intrinsics=frame.intrinsics,
            T_world_camera=frame.T_world_camera,
            Ts_world_estimate=estimates.Ts_world_part,
            scores=estimates.scores,
            residuals=estimates.residuals,
            Ts_part_tool=grasps.Ts_part_tool,
            grasps=np.array([grasps.points[i].name for i in grasps.index], dtype=str),
            openings=grasps.openings,
            verdicts=np.array([verdicts[i] for i in range(k)], dtype=str).reshape(k, len(grasps.index)),
            candidates=candidates_json(cell, considered),
            motion=Motion(np.array(time), np.stack(q), np.array(opening), np.stack(poses)),
        )

    def _watch(self) -> None:
        world, arm = self._cell.world, self._cell.arm
        self._steps += 1  # World.time does not advance during a call of several steps
        time = self._steps * world.dt
        if time < self._next - world.dt / 2:
            return
        self._next += PERIOD
        self._frames.append((time, arm.q, arm.opening, matrices_to_poses(world.part_poses())))


def candidates_json(cell: Workcell, considered: Considered) -> list[dict[str, Any]]:
    """The ranked candidates, best first, as a replay file holds them: poses, rank, and what planning made of each."""
    selection, refused = considered.selection, considered.decision.refused
    verdicts = candidate_verdicts(selection, considered.decision, cell.gripper_boxes)
    return [
        {
            "estimate": c.estimate,
            "grasp": c.point.name,
            "T_world_tool": c.T_world_tool,
            "opening": c.opening,
            "rank": round(c.rank, 4),
            "terms": rounded_terms(c),
            "verdict": verdicts[i],
            "detail": str(refused[i]) if i in refused else "",
        }
        for i, c in enumerate(selection.candidates)
    ]
