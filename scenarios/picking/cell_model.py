"""The model of a cell for planning: scenario, workpiece, robot, gripper and boxes, without the physics."""

from __future__ import annotations

from dataclasses import dataclass

from pickproof.cell.frames import Array
from pickproof.cell.geometry.bin import Bin, Box
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.grasping.grasp_points import GraspPoses
from pickproof.robots.kinematics.model import RobotModel
from pickproof.scenarios.config.scenario import Scenario
from pickproof.scenarios.placing.factory import Place, place_of

SOURCE, PLACE = "source", "place"
"""Names of the two bins, in snapshots and in the names of their boxes."""
CARRY_ACCELERATION = 15.0  # [m/s2] of the TCP with a workpiece, at full speed scale


@dataclass(frozen=True)
class CellModel:
    """The known parts of a cell.

    Attributes:
        grasps: grasp poses of the workpiece for the gripper.
        home: (6,) joints before the first pick, of the arm in [rad], or of the floating gripper in [m] and [rad].
        source, place: the bins.
        obstacles: static boxes of the cell: table and both bins.
    """

    scenario: Scenario
    workpiece: Workpiece
    robot: RobotModel
    gripper: Gripper
    grasps: GraspPoses
    home: Array
    source: Bin
    place: Bin
    obstacles: tuple[Box, ...]

    @property
    def dt(self) -> float:
        """Time step of physics and trajectories in [s]."""
        return self.scenario.physics.timestep

    @property
    def carry_acceleration(self) -> float:
        """Largest acceleration in [m/s2] of the TCP with a workpiece."""
        return CARRY_ACCELERATION * self.scenario.carry.speed_scale

    @property
    def gripper_boxes(self) -> frozenset[str]:
        """Names of the gripper's collision boxes, to distinguish its collisions from the arm's."""
        return frozenset(box.name for box in self.gripper.boxes(0.0))

    def new_place(self) -> Place:
        """The empty places of the scenario."""
        return place_of(self.scenario, self.place, self.workpiece, self.gripper)
