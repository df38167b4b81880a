"""Whether the grasp trials say the same with twice the iterations of the contact solver."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass

import numpy as np

from pickproof.cell.frames import Array
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.physics.convergence import MOST, solver_iterations
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.grasping.candidates import GraspCandidate
from pickproof.grasping.grasp_points import GraspPoint
from pickproof.scenarios.grasp_trials.check import lying
from pickproof.scenarios.grasp_trials.trial import PlacedGrasp, TrialCell, pose_errors, try_errors

GRASPS = 4
"""Grasps that are tried again, each with every error of the pose."""
ALIKE = 0.9
"""Share of trials that must come out the same: at the edge of what holds, the last bit decides."""


@dataclass(frozen=True)
class Convergence:
    """What trials said with `iterations` and with twice as many.

    Attributes:
        iterations: of the contact solver, under which the trials are converged.
        needed: that follow from the masses alone.
        trials, same: number that were made twice, and that came out the same.
    """

    iterations: int
    needed: int
    trials: int
    same: int

    @property
    def raised(self) -> bool:
        """More are needed than the masses tell, so the scenario has to say it."""
        return self.iterations > self.needed

    @property
    def text(self) -> str:
        """In words."""
        said = f"{self.iterations} solver iterations"
        if self.raised:
            said += f" in place of {self.needed}"
        if not self.trials:
            return f"{said} by the masses of part and gripper; no grasp to try with twice as many"
        return f"{said}; with twice as many {self.same} of {self.trials} grasp trials come out the same"


def check_convergence(workpiece: Workpiece, gripper: Gripper, points: Sequence[GraspPoint]) -> Convergence:
    """Double the iterations until trials of some of the grasps come out the same, at most up to MOST."""
    needed = solver_iterations(workpiece, gripper)
    spread = [points[i] for i in np.unique(np.linspace(0, len(points) - 1, GRASPS).astype(int))] if points else []
    iterations, verdicts = needed, _verdicts(workpiece, gripper, spread, needed)
    while True:
        doubled = _verdicts(workpiece, gripper, spread, 2 * iterations)
        same = int((verdicts == doubled).sum())
        if same >= ALIKE * len(verdicts) or 2 * iterations > MOST:
            return Convergence(iterations, needed, len(verdicts), same)
        iterations, verdicts = 2 * iterations, doubled


def _verdicts(workpiece: Workpiece, gripper: Gripper, points: Sequence[GraspPoint], iterations: int) -> np.ndarray:
    """Which trials (n,) hold: each grasp in the likeliest pose that leaves it room, with every error of the pose."""
    held: list[bool] = []
    with closing(TrialCell(workpiece, gripper, iterations)) as cell:
        resting = cell.resting_poses()
        for point in points:
            place = _first(point, resting, workpiece, gripper)
            if place is not None:
                k, best = place
                placed = PlacedGrasp(resting[k], best.T_world_tool, best.opening)
                trials = try_errors(cell, placed, pose_errors(workpiece))
                held += [trial.held for trial in trials]
    return np.array(held, dtype=bool)


def _first(
    point: GraspPoint, resting: Array, workpiece: Workpiece, gripper: Gripper
) -> tuple[int, GraspCandidate] | None:
    return next(((k, best) for k, (best, *_) in lying(point, resting, workpiece, gripper)), None)
