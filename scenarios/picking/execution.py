"""Execution of one pick in the physics: to the grasp, lift, transfer, place, and recovery after failures.

The grip force is the gripper's (`cell/grippers/*.yaml`); closing and opening are in `cell/physics/grip.py`.
"""

from __future__ import annotations

import numpy as np

from pickproof.cell.frames import Array, invert
from pickproof.cell.physics.grip import grip, held, release
from pickproof.cell.physics.observation import Snapshot
from pickproof.cell.physics.trajectory_execution import MotionLog, execute, wait
from pickproof.scenarios.picking.double_pick import count_by_weight
from pickproof.scenarios.picking.recovery import FALL_TIME, back_off, put_back, recover
from pickproof.scenarios.picking.snapshots import AttemptPictures
from pickproof.scenarios.picking.stages import Considered, Evidence, ExecutedPick, PlannedPick, Weighed
from pickproof.scenarios.picking.workcell import Workcell
from pickproof.scenarios.placing.factory import Place

RELEASE_EXTRA = (0.024, 0.016, 0.008)  # [m] wider than during the approach, where there is clearance
REST_LIMIT = 2.0  # [s] in which the workpieces must come to rest after the arm has stopped


def execute_pick(
    cell: Workcell, place: Place, considered: Considered, pictures: AttemptPictures, rng: np.random.Generator
) -> ExecutedPick:
    """Execute the pick that was decided on.

    The arm ends where it released the workpiece, with open jaws and outside the camera's view; the next motion starts
    there. A contact above the force limit stops the arm, as a controller's collision guard does. It then retreats along
    its path; only if that fails too, it is reset to home, as by an operator.

    Args:
        rng: noise of the wrist's force sensor.

    Raises:
        ValueError: the decision was not to move.
        SimulationError: the physics broke down.
    """
    pick = considered.decision.pick
    if pick is None:
        raise ValueError("a no-pick cannot be executed")
    T_world_release = _release_pose(pick, place)
    run = _PickRun(cell, place, pick, pictures)
    run.approach()
    if not run.log.stopped:
        run.grasp()
    if run.closed:
        run.lift()
    if run.closed and not run.log.stopped:
        run.carry()
    if run.closed and not run.log.stopped:
        run.weigh(rng)
    if run.weighed is not None and not run.log.stopped:
        run.put_down()
    run.stop_clock()
    if run.log.stopped:
        run.draw_back()
    T_world_estimate = considered.estimates.Ts_world_part[pick.candidate.estimate]
    return ExecutedPick(pick, T_world_estimate, T_world_release, run.evidence(considered.before))


class _PickRun:
    """One pick during execution; its methods are the steps, its attributes the observations so far."""

    def __init__(self, cell: Workcell, place: Place, pick: PlannedPick, pictures: AttemptPictures) -> None:
        self._cell, self._place, self._pick, self._pictures = cell, place, pick, pictures
        self._world, self._arm = cell.world, cell.arm
        self._begun, self._opening_before = cell.world.time, cell.arm.opening
        self._way_in: list[Array] = [np.zeros((0, 6))]  # rows commanded before the grasp, and after it
        self._way_on: list[Array] = [np.zeros((0, 6))]
        self._seconds = 0.0
        self.log = MotionLog()
        self.closed: tuple[int, ...] = ()
        self.lifted: tuple[int, ...] = ()
        self.carried: tuple[int, ...] = ()
        self.weighed: Weighed | None = None
        self.released = self.set_back = False

    def approach(self) -> None:
        """To the grasp; the jaws take their opening once they have left the last place, where a workpiece lies."""
        plan = self._pick.plan
        self._follow(self._way_in, plan.approach.q[: plan.cleared])
        if not self.log.stopped:
            self._arm.hold_jaws(self._pick.candidate.opening)
            self._follow(self._way_in, plan.approach.q[plan.cleared :])

    def grasp(self) -> None:
        """Close the gripper; where nothing is held, back off."""
        taken = grip(self._world, self._arm)
        self.closed = taken.parts
        self.log += taken.log
        self._pictures.stage("grasp")
        if not self.closed:
            self.log += back_off(self._cell, self._pick)

    def lift(self) -> None:
        """Out of the bin."""
        self._follow(self._way_on, self._pick.plan.lift.q)
        self.lifted = held(self._world, self._arm)
        self._pictures.stage("lift")

    def carry(self) -> None:
        """To the place."""
        self._follow(self._way_on, self._pick.plan.carry.q)
        self.carried = () if self.log.stopped else held(self._world, self._arm)
        self._pictures.stage("place")

    def weigh(self, rng: np.random.Generator) -> None:
        """Check by the wrist sensor whether exactly one workpiece is held."""
        self.weighed, log = count_by_weight(self._cell, self._pick.plan.carry, rng)
        self.log += log
        if self.log.stopped:
            self.carried = ()

    def put_down(self) -> None:
        """Release one workpiece and leave the place; several are put back to where they were taken."""
        if self.weighed is Weighed.SEVERAL:
            self.carried = ()
            self.log += put_back(self._cell, self._pick)
            return
        cell, place, world, arm = self._cell, self._place, self._world, self._arm
        opened = release(world, arm, release_opening(cell, place, self._pick.candidate.opening, arm.tool_pose()))
        self.log += opened.log
        if opened.parts and place.room(arm.tool_pose(), cell.gripper.max_opening):  # it leans on both fingers
            opened = release(world, arm, cell.gripper.max_opening)
            self.log += opened.log
        self.released = not opened.parts
        if len(self._pick.plan.leave.q) > 1:  # otherwise it falls while the next image is taken
            self.log += wait(world, arm, FALL_TIME)
            self._follow(self._way_on, self._pick.plan.leave.q)

    def stop_clock(self) -> None:
        """End of the robot time."""
        self._seconds = self._world.time - self._begun

    def draw_back(self) -> None:
        """Retreat along the path after a collision; reset to home where that fails."""
        plan, way_in, opening = self._pick.plan, np.concatenate(self._way_in), self._opening_before
        if len(way_in) > plan.cleared:  # as `back_off`, only to where it had left the last place
            way_in, opening = way_in[plan.cleared :], self._pick.candidate.opening
        back = recover(self._cell, self._pick.candidate, way_in, np.concatenate(self._way_on), opening)
        self.stop_clock()
        self.set_back = back.stopped
        if self.set_back:
            self._arm.reset(self._cell.home)

    def evidence(self, before: Snapshot) -> Evidence:
        """The evidence of the pick, after the workpieces have had time to come to rest."""
        if not self._world.run_until_rest(REST_LIMIT):
            # the outcome of this attempt is kept; the next attempt sees them at rest
            self._world.unanchor(np.flatnonzero(~self._world.at_rest()).tolist())
        return Evidence(
            before=before,
            after=self._cell.observe(),
            closed=self.closed,
            lifted=self.lifted,
            carried=self.carried,
            released=self.released,
            log=self.log,
            seconds=self._seconds,
            put_back=self.weighed is Weighed.SEVERAL,
            set_back=self.set_back,
            weighed=self.weighed,
        )

    def _follow(self, way: list[Array], rows: Array) -> None:
        """Command joint vectors (n, 6) and keep those that were reached in `way`."""
        done = execute(self._world, self._arm, rows, stop_above=self._cell.scenario.limits.contact_force_N)
        way.append(rows[: done.rows])
        self.log += done


def release_opening(cell: Workcell, place: Place, planned: float, T_world_tool: Array) -> float:
    """Opening [m] for the release at a TCP pose over the place: wide enough to release, without a finger collision.

    A blocked finger stops the other one, and the workpiece stays in the jaws; too small an opening drags it along.
    """
    for opening in (planned + extra for extra in RELEASE_EXTRA if planned + extra <= cell.gripper.max_opening):
        if place.room(T_world_tool, opening):
            return opening
    return planned


def _release_pose(pick: PlannedPick, place: Place) -> Array:
    """T_world_part (4, 4) of the workpiece where a plan releases it, with the place at planning time."""
    T_part_tool = pick.candidate.T_part_tool
    return place.tool_poses(T_part_tool, pick.candidate.opening)[pick.plan.place] @ invert(T_part_tool)
