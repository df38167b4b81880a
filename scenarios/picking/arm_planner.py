"""Plans the arm's motion for candidates in turn, with the measured heap as an obstacle."""

from __future__ import annotations

import numpy as np

from pickproof.cell.frames import Array, apply, invert
from pickproof.cell.grippers.parallel_jaw import ParallelJaw
from pickproof.cell.physics.trajectory_execution import OPEN_EASE
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.grasping.candidates import GraspCandidate
from pickproof.robots.collision.held_part import HeldPart
from pickproof.robots.collision.scene import CollisionScene, HeightField
from pickproof.robots.failure import PlanFailure
from pickproof.robots.motion.dynamics import Load
from pickproof.robots.plan.pick_plan import PickPlan, check_grasps, plan_pick
from pickproof.robots.plan.pick_request import (
    CarriedPart,
    Hand,
    Lines,
    MotionLimits,
    PathSearch,
    PickRequest,
    PlacePoses,
)
from pickproof.scenarios.picking.cell_model import CellModel
from pickproof.scenarios.picking.episode_state import EpisodeState, waits_at
from pickproof.scenarios.picking.heap_heightmap import Scan

SEARCHES = 6
"""Candidates of a decision for which a path may be searched (seconds each); later ones get only simple motions."""
OVER_RIM = 0.008  # [m] height of the lowest corner of the part over the rim when it is out of the bin


class ArmPlanner:
    """Plans of the arm for candidates in turn; collision scenes are built once for each opening."""

    def __init__(self, cell: CellModel, frame: DepthFrame, state: EpisodeState, seed: int) -> None:
        self._cell, self._state, self._seed = cell, state, seed
        self._scan = Scan.of(cell, frame)
        self._placed = state.placed.heights(), state.placed.heights(last=False)
        self._scenes: dict[float, CollisionScene] = {}
        self._piles: dict[int, HeightField] = {}
        self.planned = 0

    def __call__(self, candidate: GraspCandidate) -> PickPlan | PlanFailure:
        """The pick of a candidate, or the failure of planning."""
        cell, opening = self._cell, candidate.opening
        if opening not in self._scenes:
            self._scenes[opening] = self._scene(opening)
        scene = self._scenes[opening]
        stop = next(iter(check_grasps(scene, candidate.T_world_tool[None], cell.gripper.T_flange_tool)))
        if stop is not None:
            return stop
        self.planned += 1
        search = PathSearch(allowed=self.planned <= SEARCHES, seed=self._seed)
        return plan_pick(scene, request_of(cell, candidate, self._state, search, self._pile_without(candidate)))

    def _scene(self, opening: float) -> CollisionScene:
        """Collision scene with the heap and the placed workpieces, for a gripper that is `opening` [m] open."""
        cell = self._cell
        waits = None if self._state.waits_at is None else cell.gripper.flange_boxes(self._state.opened)
        boxes = cell.gripper.flange_boxes(opening)
        kept_clear = ["pile", *(box.name for box in cell.source.boxes() if "wall" in box.name)]
        return CollisionScene(cell.robot, boxes, cell.obstacles, self._scan.field, waits, *self._placed, kept_clear)

    def _pile_without(self, candidate: GraspCandidate) -> HeightField:
        k = candidate.estimate
        if k not in self._piles:
            T_world_part = candidate.T_world_tool @ invert(candidate.T_part_tool)
            self._piles[k] = self._scan.without(T_world_part, self._cell.workpiece)
        return self._piles[k]


def request_of(
    cell: CellModel,
    candidate: GraspCandidate,
    state: EpisodeState,
    search: PathSearch,
    pile_without: HeightField | None = None,
) -> PickRequest:
    """The request to the planner for one candidate; `pile_without`: the scanned pile without its workpiece."""
    T_flange_tool, T_tool_part = cell.gripper.T_flange_tool, invert(candidate.T_part_tool)
    held = HeldPart(cell.workpiece.pieces, T_tool_part)
    places = state.place.tool_poses(candidate.T_part_tool, candidate.opening)
    cups, middle = not isinstance(cell.gripper, ParallelJaw), cell.source.T_world_bin[:2, 3]
    retract = _retract_direction(candidate.T_world_tool, middle) if cups else (0.0, 0.0, 1.0)
    load = Load(cell.workpiece.mass, apply(T_flange_tool @ T_tool_part, cell.workpiece.com[None])[0])
    return PickRequest(
        q_start=waits_at(cell, state),
        q_end=None,
        T_base_tool_grasp=candidate.T_world_tool,
        places=PlacePoses(places, state.place.ranks()),
        hand=Hand(
            T_flange_tool, Load(cell.gripper.mass, cell.gripper.centre), _narrowing(cell, candidate.opening, state)
        ),
        part=CarriedPart(held, load, pile_without=pile_without),
        lines=Lines(
            approach=candidate.point.approach_distance,
            retract=candidate.point.retract_distance,
            retract_direction=retract,
            out_of_bin=_out_of_bin(cell, held.seen_from(candidate.T_world_tool), retract[2]),
            place=state.place.line,
            depart=0.0 if state.waits_at is None else state.place.line,
            straight=cell.scenario.carry.straight,
            straight_place=cell.scenario.straight_place,
        ),
        limits=MotionLimits(carry_acceleration=cell.carry_acceleration, dt=cell.dt),
        search=search,
    )


def _out_of_bin(cell: CellModel, held: HeldPart, up: float) -> float:
    """Length in [m] of the line on which a part, given in the world, comes OVER_RIM over the rim; `up` is its slope."""
    rim = cell.source.T_world_bin[2, 3] + cell.source.inner[2]
    return float(max(0.0, rim + OVER_RIM - held.corners[:, 2].min()) / up)


def _retract_direction(T_world_tool: Array, middle: Array) -> tuple[float, float, float]:
    """Unit vector halfway between up and the reverse approach of a tilted tool, where that leads inwards.

    Cups and magnets hold one face: a lift straight up would drag a workpiece that leans on a wall along that wall. A
        tool tilted over the nearest wall, away from `middle` (2,) of the bin, moves straight up.
    """
    half = np.array([0.0, 0.0, 1.0]) - T_world_tool[:3, 2]
    if half[:2] @ (middle - T_world_tool[:2, 3]) <= 0:
        return 0.0, 0.0, 1.0
    x, y, z = (half / np.linalg.norm(half)).tolist()
    return x, y, z


def _narrowing(cell: CellModel, opening: float, state: EpisodeState) -> float:
    """Time in [s] in which the jaws move from the waiting opening to a narrower `opening` [m]."""
    if state.waits_at is None or not isinstance(cell.gripper, ParallelJaw) or state.opened <= opening:
        return 0.0
    return (state.opened - opening) / 2 / cell.gripper.speed + OPEN_EASE
