"""Carriers of the gripper: the robot arm, or the floating gripper of the motion oracle."""

from __future__ import annotations

from typing import Any, Protocol

from pickproof.cell.frames import Array
from pickproof.cell.geometry.bin import Bin
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.physics.arm import Arm
from pickproof.cell.physics.floating_gripper import floating_arm, floating_home
from pickproof.cell.physics.world import World
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.grasping.candidates import GraspCandidate
from pickproof.robots.failure import PlanFailure
from pickproof.robots.kinematics.model import RobotModel
from pickproof.robots.motion.trajectory import Trajectory, joint_move
from pickproof.robots.plan.pick_plan import PickPlan
from pickproof.robots.program.waypoints import before_end, waypoints_of, waypoints_to_json
from pickproof.scenarios.picking.arm_planner import ArmPlanner
from pickproof.scenarios.picking.cell_model import CellModel
from pickproof.scenarios.picking.episode_state import EpisodeState, waits_at
from pickproof.scenarios.picking.motion_oracle import FloatingPlanner, floating_raise

RAISE_SPEED = 0.3  # share of the joint limits at which the arm raises a workpiece for weighing


class Planner(Protocol):
    """Plans candidates of one image in turn; `planned` counts those for which a motion was searched."""

    planned: int

    def __call__(self, candidate: GraspCandidate) -> PickPlan | PlanFailure:
        """The pick of a candidate, or where planning ended."""


class Carrier(Protocol):
    """Carrier of the gripper.

    Attributes:
        name: as stored in replay files.
    """

    name: str

    def home(self, place: Bin, gripper: Gripper) -> Array:
        """Joints (6,) before the first pick."""
        ...

    def build(self, world: World, gripper: Gripper) -> Arm:
        """Its body in the physics, with the gripper."""
        ...

    def planner(self, cell: CellModel, frame: DepthFrame, state: EpisodeState, seed: int) -> Planner:
        """The planner of one image; `seed` is that of path searches."""
        ...

    def ranking_start(self, cell: CellModel, state: EpisodeState) -> Array:
        """Joints (6,) [rad] of the arm from which the rank's term of motion time counts."""
        ...

    def raised(self, cell: CellModel, carry: Trajectory, height: float) -> Array:
        """Joints (n, 6) from the end of `carry`, at the place, to `height` [m] over it."""
        ...

    def waypoints(self, cell: CellModel, plan: PickPlan) -> Any:
        """Points of a plan as JSON for the record and robot programs; None without a robot."""
        ...


class ArmCarrier:
    """The scenario's robot."""

    name = "arm"

    def __init__(self, robot: RobotModel) -> None:
        self._robot = robot

    def home(self, place: Bin, gripper: Gripper) -> Array:
        """See `Carrier.home`."""
        return self._robot.home

    def build(self, world: World, gripper: Gripper) -> Arm:
        """See `Carrier.build`."""
        return Arm(world, self._robot.urdf, self._robot.joints, gripper)

    def planner(self, cell: CellModel, frame: DepthFrame, state: EpisodeState, seed: int) -> Planner:
        """See `Carrier.planner`."""
        return ArmPlanner(cell, frame, state, seed)

    def ranking_start(self, cell: CellModel, state: EpisodeState) -> Array:
        """See `Carrier.ranking_start`."""
        return waits_at(cell, state)

    def raised(self, cell: CellModel, carry: Trajectory, height: float) -> Array:
        """See `Carrier.raised`."""
        high = before_end(self._robot, carry, cell.gripper.T_flange_tool, height)
        return joint_move(self._robot, carry.q[-1], carry.q[high], RAISE_SPEED, cell.dt).q

    def waypoints(self, cell: CellModel, plan: PickPlan) -> Any:
        """See `Carrier.waypoints`."""
        T_flange_tool, scenario = cell.gripper.T_flange_tool, cell.scenario
        points = waypoints_of(self._robot, plan, T_flange_tool, scenario.carry.straight, scenario.straight_place)
        return waypoints_to_json(points)


class FloatingCarrier:
    """The motion oracle: a floating gripper that reaches every pose; only the gripper itself can collide."""

    name = "gantry"  # stored in replay files since the first version, so it is kept

    def home(self, place: Bin, gripper: Gripper) -> Array:
        """See `Carrier.home`."""
        return floating_home(place, gripper)

    def build(self, world: World, gripper: Gripper) -> Arm:
        """See `Carrier.build`."""
        return floating_arm(world, gripper)

    def planner(self, cell: CellModel, frame: DepthFrame, state: EpisodeState, seed: int) -> Planner:
        """See `Carrier.planner`."""
        return FloatingPlanner(cell, frame, state)

    def ranking_start(self, cell: CellModel, state: EpisodeState) -> Array:
        """The arm's home pose, since the floating gripper has no arm joints."""
        return cell.robot.home

    def raised(self, cell: CellModel, carry: Trajectory, height: float) -> Array:
        """See `Carrier.raised`."""
        return floating_raise(carry.q[-1], height, cell.dt)

    def waypoints(self, cell: CellModel, plan: PickPlan) -> Any:
        """See `Carrier.waypoints`."""
        return None
