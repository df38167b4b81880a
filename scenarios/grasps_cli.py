"""`pickproof grasps ...`: grasp points of a workpiece imported and exported."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import yaml

from cell.errors import InputError
from cell.frames import Array, from_rpy
from cell.gripper import load_gripper
from cell.workpiece import load_workpiece
from grasping.grasp_points import GraspPoint, GraspTable, load_grasps
from grasping.isaac_grasp import isaac_grasps_text, read_isaac_grasps

GRIPPER = "jaw_v1"
SIX = ("X", "Y", "Z", "ROLL", "PITCH", "YAW")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of the command `grasps`."""
    commands = parser.add_subparsers(required=True, metavar="COMMAND", dest="grasps_command")
    importing = commands.add_parser("import", help="an isaac_grasp file (format version 1.0) as grasps.yaml")
    importing.add_argument("workpiece", metavar="WORKPIECE")
    importing.add_argument("file", type=Path, metavar="FILE")
    importing.set_defaults(run=_import)
    exporting = commands.add_parser("export", help="grasps.yaml as an isaac_grasp file (format version 1.0)")
    exporting.add_argument("workpiece", metavar="WORKPIECE")
    exporting.set_defaults(run=_export)
    for command in (importing, exporting):
        command.add_argument("--gripper", default=GRIPPER, metavar="G", help=f"default {GRIPPER}")
        command.add_argument("--out", type=Path, metavar="FILE", help="write there; default: to standard output")
        command.add_argument(
            "--tool",
            nargs=6,
            type=float,
            default=[0.0] * 6,
            metavar=SIX,
            help="our tool centre point in the other program's gripper frame, in [m] and [deg]; default: that frame",
        )


def main_grasps(args: argparse.Namespace) -> int:
    """Run the command; returns the exit code."""
    run: Callable[[argparse.Namespace], int] = args.run
    return run(args)


def _import(args: argparse.Namespace) -> int:
    workpiece, gripper = load_workpiece(args.workpiece), load_gripper(args.gripper)
    points = read_isaac_grasps(args.file, _tool(args))
    reach = float(np.linalg.norm(workpiece.extents)) / 2
    for point in points:
        if point.opening is not None and point.opening > gripper.max_opening:
            valid = f"an opening of at most {gripper.max_opening} m, that of {gripper.name}"
            raise InputError(args.file, f"grasps.{point.name}", point.opening, valid)
        if np.linalg.norm(point.centre) > reach:
            valid = f"a tool centre point on {workpiece.name}, within {reach:.3f} m of its CAD origin (see --tool)"
            raise InputError(args.file, f"grasps.{point.name}.position", point.centre, valid)
    return _write(table_text(points, gripper.name), args.out)


def _export(args: argparse.Namespace) -> int:
    workpiece, gripper = load_workpiece(args.workpiece), load_gripper(args.gripper)
    text = isaac_grasps_text(load_grasps(workpiece, gripper), workpiece.name, gripper.name, _tool(args))
    return _write(text, args.out)


def table_text(points: list[GraspPoint], gripper: str, comment: str = "") -> str:
    """The text of a grasps.yaml; fields that have their default are left out."""
    table = GraspTable(gripper=gripper, grasps=points).model_dump(mode="json", exclude_defaults=True)
    head = "".join(f"# {line}\n" for line in comment.splitlines())
    return head + str(yaml.safe_dump(table, sort_keys=False, default_flow_style=None, width=120))


def _tool(args: argparse.Namespace) -> Array:
    return from_rpy(args.tool[:3], np.deg2rad(args.tool[3:]))


def _write(text: str, path: Path | None) -> int:
    if path is None:
        sys.stdout.write(text)
    else:
        path.write_text(text, encoding="utf-8")
        print(f"wrote {path}")
    return 0
