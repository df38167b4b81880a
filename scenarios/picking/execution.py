"""The motion of one pick in the physics: to the grasp, up, over, down, and what to do when something goes wrong."""

from __future__ import annotations

import numpy as np

from pickproof.cell.frames import Array
from pickproof.cell.physics.grip import grip, held, release
from pickproof.cell.physics.observation import Snapshot
from pickproof.cell.physics.trajectory_execution import MotionLog, execute, wait
from pickproof.grasping.candidates import GraspCandidate
from pickproof.robots.plan.pick_plan import PickPlan
from pickproof.scenarios.picking.double_pick import Weighed, count_by_weight
from pickproof.scenarios.picking.outcome import Evidence
from pickproof.scenarios.picking.recovery import FALL_TIME, back_off, put_back, recover
from pickproof.scenarios.picking.snapshots import snap
from pickproof.scenarios.picking.workcell import Workcell
from pickproof.scenarios.placing.factory import Place

RELEASE_EXTRA = (0.024, 0.016, 0.008)  # [m] wider than on the way in, where there is room
REST_LIMIT = 2.0  # [s] the workpieces have to come to rest after the arm is home


def move(
    cell: Workcell,
    place: Place,
    candidate: GraspCandidate,
    plan: PickPlan,
    before: Snapshot,
    pose_ok: bool,
    staged: bool,
    pictures: dict[str, bytes],
    rng: np.random.Generator,
) -> tuple[Evidence, float]:
    """Execute a plan in the physics; returns what was seen and the robot's time in [s].

    With `staged`, pictures of the cell at each stage are added to `pictures`; `rng` is of the wrist's force sensor.

    The arm ends where it let the workpiece go, its jaws open, out of the camera's view: the next motion starts there. A
    hard touch stops the arm, as a controller's collision guard does; it then draws back the way it came, and only where
    that fails as well is it set back to home by hand.
    """
    world, arm, limit = cell.world, cell.arm, cell.scenario.limits.contact_force_N
    start, opening = world.time, arm.opening
    commanded: dict[str, list[Array]] = {"in": [], "on": []}

    def run(leg: str, rows: Array) -> MotionLog:
        done = execute(world, arm, rows, stop_above=limit)
        commanded[leg].append(rows[: done.rows])
        return done

    way_out, way_in = plan.approach.q[: plan.cleared], plan.approach.q[plan.cleared :]
    log = run("in", way_out)  # the last workpiece lies between the fingers
    if not log.stopped:
        arm.hold_jaws(candidate.opening)
        log += run("in", way_in)
    closed: tuple[int, ...] = ()
    lifted, carried, released = closed, closed, False
    weighed: Weighed | None = None
    if not log.stopped:
        taken = grip(world, arm)
        closed, log = taken.parts, log + taken.log
        if staged:
            snap(cell, pictures, "grasp")
        if not closed:
            log += back_off(cell, candidate, plan)
    if closed:
        log += run("on", plan.lift.q)
        lifted = held(world, arm)
        if staged:
            snap(cell, pictures, "lift")
    if closed and not log.stopped:
        log += run("on", plan.carry.q)
        carried = () if log.stopped else held(world, arm)
        if staged:
            snap(cell, pictures, "place")
    if closed and not log.stopped:
        weighed, weighing = count_by_weight(cell, plan, rng)
        log += weighing
        if log.stopped:
            carried = ()
        elif weighed is Weighed.SEVERAL:
            carried = ()
            log += put_back(cell, candidate, plan)
        else:
            opened = release(world, arm, release_opening(cell, place, candidate.opening, arm.tool_pose()))
            log += opened.log
            if opened.parts and place.room(arm.tool_pose(), cell.gripper.max_opening):  # it leans on both fingers
                opened = release(world, arm, cell.gripper.max_opening)
                log += opened.log
            released = not opened.parts
            if len(plan.leave.q) > 1:  # else it falls while the next image is taken
                log += wait(world, arm, FALL_TIME) + run("on", plan.leave.q)
    robot_s = world.time - start
    set_back = False
    if log.stopped:
        legs = [np.concatenate([np.zeros((0, 6)), *rows]) for rows in commanded.values()]
        if len(legs[0]) > plan.cleared:  # as `back_off`, only to where it had left the last place
            legs[0], opening = legs[0][plan.cleared :], candidate.opening
        back = recover(cell, candidate, legs[0], legs[1], opening)
        robot_s, set_back = world.time - start, back.stopped
        if set_back:
            arm.reset(cell.home)
    if not world.run_until_rest(REST_LIMIT):
        # this attempt's verdict stands; the next sees them still
        world.unanchor(np.flatnonzero(~world.at_rest()).tolist())
    after = cell.observe()
    double = weighed is Weighed.SEVERAL
    seen = Evidence(
        before, after, closed, lifted, carried, released, log, robot_s, pose_ok, double, set_back, weighed=weighed
    )
    return seen, robot_s


def release_opening(cell: Workcell, place: Place, planned: float, T_world_tool: Array) -> float:
    """How far to open at a TCP pose over the place, in [m]: nothing sticks, yet no finger meets what stands there.

    A finger that is stopped stops the other, and the workpiece stays in the jaws; fingers that open by a hair drag it.
    """
    for opening in (planned + extra for extra in RELEASE_EXTRA if planned + extra <= cell.gripper.max_opening):
        if place.room(T_world_tool, opening):
            return opening
    return planned
