"""`pickproof export-program DIR --attempt N`: the motion of one attempt as a Fanuc TP program."""

from __future__ import annotations

import argparse

from rich.console import Console

from pickproof.cell.errors import InputError
from pickproof.cell.grippers.registry import load_gripper
from pickproof.robots.kinematics.model import load_robot
from pickproof.robots.program.tp_program import write_program
from pickproof.robots.program.waypoints import waypoints_from_json
from pickproof.scenarios.commands.arguments import file_to_write, integer, some_path
from pickproof.scenarios.config.scenario import Scenario
from pickproof.scenarios.results.store import Store


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of the command `export-program`."""
    parser.add_argument("directory", type=some_path, metavar="DIR", help="where `pickproof run` wrote its results")
    parser.add_argument("--attempt", required=True, metavar="N", help="index in the report's list of every attempt")
    parser.add_argument("--name", default="", help="of the program (default PICK_N)")
    parser.add_argument(
        "--output",
        type=integer(1, 999),
        default=1,
        metavar="N",
        help="robot output RO[N] that closes the gripper (default 1)",
    )
    parser.add_argument("--out", type=file_to_write, default=None, help="file (default DIR/NAME.LS)")


def main(args: argparse.Namespace) -> int:
    """Run the command; returns the exit code."""
    with Store.read(args.directory) as store:
        attempt = store.nth_attempt(args.attempt)
        scenario = Scenario.model_validate_json(store.meta()["scenario"])
    if not attempt.waypoints:
        raise InputError("command line", "--attempt", args.attempt, "an attempt in which the arm moved")
    name = args.name or f"PICK_{int(args.attempt)}"
    robot, gripper = load_robot(scenario.robot), load_gripper(scenario.gripper)
    text = write_program(
        robot, waypoints_from_json(attempt.waypoints), gripper.T_flange_tool, name, scenario.name, output=args.output
    )
    path = args.out or args.directory / f"{name}.LS"
    try:
        path.write_text(text, encoding="ascii")
    except OSError as error:
        raise InputError("command line", "--out", str(path), f"a file that can be written ({error.strerror})") from None
    Console().print(f"wrote {path}", soft_wrap=True)
    return 0
