"""The motion oracle: a floating gripper moves, so only the gripper itself can collide.

No reach, no joint limits, no singularities, no arm that collides; docs/explanation/attribution.md says what is left.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from pickproof.cell.frames import Array, make_transform
from pickproof.cell.physics.floating_gripper import floating_joints, floating_line
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.grasping.candidates import GraspCandidate
from pickproof.grasping.clearance import OpenGripper, thin, without_workpiece
from pickproof.robots.failure import Cause, PlanFailure, Refusal, Stage
from pickproof.robots.motion.trajectory import Trajectory
from pickproof.robots.plan.pick_plan import PickPlan
from pickproof.scenarios.picking.cell_model import CellModel
from pickproof.scenarios.picking.episode_state import EpisodeState
from pickproof.scenarios.picking.heap_heightmap import scene_points

OVER = 0.05  # [m] between the rims and the lowest point of a held workpiece
LONGEST = 0.4  # [m] of straight line to a grasp
SAMPLES = 10  # of that line at which the gripper must be free
RAISING = 2.0  # [m/s2]


class FloatingPlanner:
    """Plans picks on straight lines, or returns the collision of the gripper itself.

    In along the tool's own axis from above the rims, straight up, over, and straight down to the first place pose at
    which the open gripper clears the place bin.
    """

    def __init__(self, cell: CellModel, frame: DepthFrame, state: EpisodeState) -> None:
        self._cell, self._state = cell, state
        self._points = scene_points(cell, frame)
        self._height = _travel_height(cell)
        self.planned = 0

    def __call__(self, candidate: GraspCandidate) -> PickPlan | PlanFailure:
        """The pick of a candidate, or the collision of the gripper."""
        self.planned += 1
        line = _way_in(candidate.T_world_tool, self._height, candidate.point.approach_distance)
        if self._blocked(candidate, line):
            refusal = Refusal(Cause.COLLISION, contact=("gripper", "pile"), on_line=True)
            return PlanFailure(Stage.APPROACH_LINE, refusal, "way to the grasp")
        place = self._state.place
        places = place.tool_poses(candidate.T_part_tool, candidate.opening)
        shape = OpenGripper.of(self._cell.gripper.boxes(candidate.opening))
        free = np.flatnonzero(~shape.hits_bin(places, self._cell.place))
        if not len(free):
            return PlanFailure(Stage.PLACE, Refusal(Cause.COLLISION, contact=("gripper", "place")), "place")
        ranks = place.ranks()
        k = int(min(free, key=lambda i: ranks[i]))
        return self._plan(line[0], candidate.T_world_tool, places[k], k)

    def _blocked(self, candidate: GraspCandidate, line: Array) -> bool:
        """Whether the open gripper meets the bin or another workpiece at tool poses (n, 4, 4) on the way in."""
        cell, T_world_tool = self._cell, candidate.T_world_tool
        shape = OpenGripper.of(cell.gripper.boxes(candidate.opening))
        near = self._points[np.linalg.norm(self._points - T_world_tool[:3, 3], axis=1) < LONGEST]
        T_world_part = T_world_tool @ np.linalg.inv(candidate.T_part_tool)
        others = without_workpiece(thin(near), T_world_part, cell.workpiece)
        return bool(shape.hits_bin(line, cell.source).any() or shape.hits_points(line, others).any())

    def _plan(self, T_before: Array, T_grasp: Array, T_place: Array, place: int) -> PickPlan:
        """The motion through tool poses (4, 4) before and at the grasp and at the place of this index."""
        cell, up, waits = self._cell, self._height, self._state.waits_at
        start = cell.home if waits is None else waits
        before = _joints(cell, T_before)
        grasp = _joints(cell, T_grasp, before)
        lifted, over = _joints(cell, _raised(T_grasp, up), grasp), _joints(cell, _raised(T_place, up), grasp)
        down = _joints(cell, T_place, over)
        risen = start.copy()
        risen[2] = max(start[2], up + start[2] - _tool_height(cell, start))
        off = _travel(cell, [start, risen])
        approach = np.concatenate([off, _travel(cell, [risen, before, grasp])])
        return PickPlan(
            approach=_trajectory("approach", approach, cell.dt),
            lift=_trajectory("lift", _travel(cell, [grasp, lifted]), cell.dt),
            carry=_trajectory("carry", _travel(cell, [lifted, over, down]), cell.dt),
            leave=_trajectory("leave", down[None], cell.dt),
            place=place,
            branch=0,
            sigma=1.0,
            methods=("direct", "direct", "direct"),
            cleared=0 if waits is None else len(off),
        )


def floating_raise(q: Array, height: float, dt: float) -> Array:
    """Straight up by `height` [m] from joints q (6,); (n, 6)."""
    return floating_line(q, q + np.array([0.0, 0.0, height, 0.0, 0.0, 0.0]), RAISING, dt)


def _way_in(T: Array, up: float, shortest: float) -> Array:
    """Tool poses (SAMPLES, 4, 4) along the tool's axis, the first over the rims where that is not too far off."""
    rise = -float(T[2, 2])
    far = (up - float(T[2, 3])) / rise if rise > 1e-3 else LONGEST
    distance = float(np.clip(far, shortest, LONGEST))
    return np.asarray(T @ make_transform(t=[(0.0, 0.0, -d) for d in np.linspace(distance, 0.0, SAMPLES)]))


def _travel_height(cell: CellModel) -> float:
    """[m] of the TCP at which a held workpiece passes over both bins."""
    rims = [bin.position[2] + bin.inner[2] for bin in (cell.source, cell.place)]
    return max(rims) + float(np.linalg.norm(cell.workpiece.extents)) + OVER


def _tool_height(cell: CellModel, q: Array) -> float:
    """[m] of the TCP at joints q (6,); the tool's lean is that of roll and pitch."""
    reach = float(cell.gripper.T_flange_tool[2, 3])
    return float(q[2] + reach * np.cos(q[4]) * np.cos(q[5]))


def _raised(T: Array, z: float) -> Array:
    raised = T.copy()
    raised[2, 3] = max(z, float(T[2, 3]))
    return raised


def _joints(cell: CellModel, T: Array, near: Array | None = None) -> Array:
    return floating_joints(T, cell.gripper.T_flange_tool, near)


def _travel(cell: CellModel, stops: list[Array]) -> Array:
    """Straight from stop to stop (n, 6), at rest at each."""
    lines = [floating_line(a, b, cell.carry_acceleration, cell.dt) for a, b in pairwise(stops)]
    return np.concatenate(lines)


def _trajectory(name: str, q: Array, dt: float) -> Trajectory:
    return Trajectory(name, q, np.gradient(q, dt, axis=0) if len(q) > 1 else np.zeros_like(q), dt)
