"""The motion of one attempt as a Fanuc TP program."""

from __future__ import annotations

from pathlib import Path

from pickproof.cell.errors import InputError
from pickproof.cell.grippers.registry import load_gripper
from pickproof.robots.kinematics.model import load_robot
from pickproof.robots.program.tp_program import write_program
from pickproof.robots.program.waypoints import waypoints_from_json
from pickproof.scenarios.config.scenario import Scenario
from pickproof.scenarios.results.store import Store


def program_of(directory: Path, index: str, name: str = "", output: int = 1) -> tuple[str, str]:
    """Name and text of the program.

    Args:
        directory: results of a campaign.
        index: of the attempt in the report's list of every attempt.
        name: of the program; PICK_N for attempt N where it is empty.
        output: number of the robot output that closes the gripper.

    Raises:
        InputError: no such attempt, or the arm did not move in it; a name that the controller does not take.
    """
    with Store.read(directory) as store:
        attempt = store.nth_attempt(index)
        scenario = Scenario.model_validate_json(store.meta()["scenario"])
    if not attempt.waypoints:
        raise InputError("command line", "--attempt", index, "an attempt in which the arm moved")
    name = name or f"PICK_{int(index)}"
    robot, gripper = load_robot(scenario.robot), load_gripper(scenario.gripper)
    waypoints = waypoints_from_json(attempt.waypoints)
    return name, write_program(robot, waypoints, gripper.T_flange_tool, name, scenario.name, output=output)
