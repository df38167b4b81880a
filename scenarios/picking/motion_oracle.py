"""The motion oracle: a floating gripper moves, so nothing but the gripper itself can be in the way.

No reach, no joint limits, no singularities, no arm that collides; docs/statistics.md says what that leaves.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from pickproof.cell.frames import Array, make_transform
from pickproof.cell.physics.floating_gripper import floating_joints, floating_line
from pickproof.grasping.candidates import GraspCandidate
from pickproof.grasping.clearance import OpenGripper, thin, without_workpiece
from pickproof.robots.failure import Cause, PlanFailure, Refusal, Stage
from pickproof.robots.motion.trajectory import Trajectory
from pickproof.robots.plan.pick_plan import PickPlan
from pickproof.scenarios.picking.episode_state import EpisodeState
from pickproof.scenarios.picking.workcell import Workcell

OVER = 0.05  # [m] between the rims and the lowest that a held workpiece can hang
LONGEST = 0.4  # [m] of straight line to a grasp
SAMPLES = 10  # of that line at which the gripper must be free
RAISING = 2.0  # [m/s2]


def free_plan(
    cell: Workcell, points: Array, candidate: GraspCandidate, state: EpisodeState, acceleration: float
) -> PickPlan | PlanFailure:
    """The motion of one pick on straight lines, or what the gripper itself would touch.

    In along the tool's own axis from above the rims, straight up, over, and straight down to the first place pose at
    which the open gripper clears the place bin.

    Args:
        points: (n, 3) measured points in the world that are not the bin.
        acceleration: largest of the TCP in [m/s2].
    """
    T, up = candidate.T_world_tool, _travel_height(cell)
    line = _way_in(T, up, candidate.point.approach_distance)
    shape = OpenGripper.of(cell.gripper.boxes(candidate.opening))
    near = points[np.linalg.norm(points - T[:3, 3], axis=1) < LONGEST]
    T_world_part = T @ np.linalg.inv(candidate.T_part_tool)
    others = without_workpiece(thin(near), T_world_part, cell.workpiece)
    if shape.hits_bin(line, cell.source).any() or shape.hits_points(line, others).any():
        return PlanFailure(
            Stage.APPROACH_LINE, Refusal(Cause.COLLISION, contact=("gripper", "pile"), on_line=True), "way to the grasp"
        )
    places = state.place.tool_poses(candidate.T_part_tool, candidate.opening)
    free = np.flatnonzero(~shape.hits_bin(places, cell.place))
    if not len(free):
        return PlanFailure(Stage.PLACE, Refusal(Cause.COLLISION, contact=("gripper", "place")), "place")
    k = int(min(free, key=lambda i: state.place.ranks()[i]))
    return _plan(cell, candidate, line[0], places[k], k, state, up, acceleration)


def free_raise(q: Array, height: float, dt: float) -> Array:
    """Straight up by `height` [m] from joints q (6,); (n, 6)."""
    return floating_line(q, q + np.array([0.0, 0.0, height, 0.0, 0.0, 0.0]), RAISING, dt)


def _plan(
    cell: Workcell,
    candidate: GraspCandidate,
    T_before: Array,
    T_place: Array,
    k: int,
    state: EpisodeState,
    up: float,
    acceleration: float,
) -> PickPlan:
    start = cell.home if state.waits_at is None else state.waits_at
    T_lifted, T_over = _raised(candidate.T_world_tool, up), _raised(T_place, up)
    before = _joints(cell, T_before)
    grasp = _joints(cell, candidate.T_world_tool, before)
    lifted, over = _joints(cell, T_lifted, grasp), _joints(cell, T_over, grasp)
    place = _joints(cell, T_place, over)
    risen = start.copy()
    risen[2] = max(start[2], up + start[2] - _tool_height(cell, start))
    dt = cell.world.dt
    off = _travel([start, risen], acceleration, dt)
    approach = np.concatenate([off, _travel([risen, before, grasp], acceleration, dt)])
    return PickPlan(
        approach=_trajectory("approach", approach, dt),
        lift=_trajectory("lift", _travel([grasp, lifted], acceleration, dt), dt),
        carry=_trajectory("carry", _travel([lifted, over, place], acceleration, dt), dt),
        leave=_trajectory("leave", place[None], dt),
        place=k,
        branch=0,
        sigma=1.0,
        methods=("direct", "direct", "direct"),
        cleared=len(off) if state.waits_at is not None else 0,
    )


def _way_in(T: Array, up: float, shortest: float) -> Array:
    """Tool poses (SAMPLES, 4, 4) along the tool's axis, the first over the rims where that is not too far off."""
    rise = -float(T[2, 2])
    far = (up - float(T[2, 3])) / rise if rise > 1e-3 else LONGEST
    distance = float(np.clip(far, shortest, LONGEST))
    return np.asarray(T @ make_transform(t=[(0.0, 0.0, -d) for d in np.linspace(distance, 0.0, SAMPLES)]))


def _travel_height(cell: Workcell) -> float:
    """[m] of the TCP at which a held workpiece passes over both bins."""
    rims = [bin.position[2] + bin.inner[2] for bin in (cell.source, cell.place)]
    return max(rims) + float(np.linalg.norm(cell.workpiece.extents)) + OVER


def _tool_height(cell: Workcell, q: Array) -> float:
    """[m] of the TCP at joints q (6,); the tool's lean is that of roll and pitch."""
    reach = float(cell.gripper.T_flange_tool[2, 3])
    return float(q[2] + reach * np.cos(q[4]) * np.cos(q[5]))


def _raised(T: Array, z: float) -> Array:
    raised = T.copy()
    raised[2, 3] = max(z, float(T[2, 3]))
    return raised


def _joints(cell: Workcell, T: Array, near: Array | None = None) -> Array:
    return floating_joints(T, cell.gripper.T_flange_tool, near)


def _travel(stops: list[Array], acceleration: float, dt: float) -> Array:
    """Straight from stop to stop (n, 6), at rest at each."""
    lines = [floating_line(a, b, acceleration, dt) for a, b in pairwise(stops)]
    return np.concatenate(lines)


def _trajectory(name: str, q: Array, dt: float) -> Trajectory:
    return Trajectory(name, q, np.gradient(q, dt, axis=0) if len(q) > 1 else np.zeros_like(q), dt)
