"""Tool poses become joint trajectories. The only folder that imports pinocchio, coal, ompl and ruckig.

A folder with a robot.yaml is a robot, one with an __init__.py is code. How to add a robot:
docs/reference/robot-file.md.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pickproof.cell.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from pickproof.robots.collision.scene import CollisionScene, HeightField
    from pickproof.robots.failure import PlanFailure
    from pickproof.robots.kinematics.model import RobotModel, list_robots, load_robot
    from pickproof.robots.motion.trajectory import Trajectory
    from pickproof.robots.plan.pick_plan import PickPlan, PickRequest, plan_pick

__all__ = [
    "CollisionScene",
    "HeightField",
    "PickPlan",
    "PickRequest",
    "PlanFailure",
    "RobotModel",
    "Trajectory",
    "list_robots",
    "load_robot",
    "plan_pick",
]

_MODULES = {
    "CollisionScene": "collision.scene",
    "HeightField": "collision.scene",
    "PickPlan": "plan.pick_plan",
    "PickRequest": "plan.pick_plan",
    "PlanFailure": "failure",
    "RobotModel": "kinematics.model",
    "Trajectory": "motion.trajectory",
    "list_robots": "kinematics.model",
    "load_robot": "kinematics.model",
    "plan_pick": "plan.pick_plan",
}

__getattr__, __dir__ = lazy_exports(__name__, _MODULES)
