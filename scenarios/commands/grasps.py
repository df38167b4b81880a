"""`pickproof grasps ...`: grasp points of a workpiece edited, checked, proposed, imported and exported."""

from __future__ import annotations

import argparse
import json
import secrets
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from pickproof.cell.config import read_yaml
from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array, from_rpy
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from pickproof.grasping.grasp_points import load_grasps
from pickproof.grasping.isaac_grasp import isaac_grasps_text, read_isaac_grasps
from pickproof.scenarios.commands.arguments import MAX_SEED, file_to_write, folder_to_write, integer, number, some_path
from pickproof.scenarios.files.atomic import write_whole
from pickproof.scenarios.files.grasps_text import table_text

GRIPPER = "jaw_v1"
HOST = "127.0.0.1"
SIX = ("X", "Y", "Z", "ROLL", "PITCH", "YAW")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of the command `grasps`."""
    commands = parser.add_subparsers(required=True, metavar="COMMAND", dest="grasps_command")
    importing = commands.add_parser("import", help="an isaac_grasp file (format version 1.0) as grasps.yaml")
    importing.add_argument("workpiece", metavar="WORKPIECE")
    importing.add_argument("file", type=some_path, metavar="FILE")
    importing.set_defaults(run=_import)
    exporting = commands.add_parser("export", help="grasps.yaml as an isaac_grasp file (format version 1.0)")
    exporting.add_argument("workpiece", metavar="WORKPIECE")
    exporting.set_defaults(run=_export)
    checking = commands.add_parser("check", help="try each grasp on a lone workpiece in every resting pose")
    checking.add_argument("workpiece", metavar="WORKPIECE")
    checking.add_argument("--json", action="store_true", help="print the trials as JSON")
    checking.set_defaults(run=_check)
    sampling = commands.add_parser("sample", help="propose grasp points from the CAD, tried in the physics")
    sampling.add_argument("workpiece", metavar="WORKPIECE")
    sampling.add_argument(
        "--count", type=integer(1, 10_000), default=12, metavar="N", help="proposals tried (default 12)"
    )
    sampling.add_argument(
        "--seed", type=integer(0, MAX_SEED), default=0, metavar="S", help="of the rays through the CAD"
    )
    sampling.add_argument(
        "--least",
        type=number(0, 0.999),
        default=0.5,
        metavar="SHARE",
        help="of pose errors that a kept grasp bears (default 0.5)",
    )
    sampling.add_argument("--out", type=file_to_write, metavar="FILE", help="write there; default: to standard output")
    sampling.set_defaults(run=_sample)
    editing = commands.add_parser("edit", help="move, judge, try and save grasps on a page in the browser")
    editing.add_argument("workpiece", metavar="WORKPIECE")
    editing.add_argument("--gripper", metavar="G", help="default: that of the workpiece's grasps.yaml")
    editing.add_argument("--grasps", type=file_to_write, metavar="FILE", help="default: the workpiece's grasps.yaml")
    editing.add_argument("--port", type=integer(0, 65535), default=8080, help="of the page (default 8080)")
    editing.add_argument(
        "--host", default=HOST, metavar="H", help=f"address to listen on (default {HOST}); others need the token"
    )
    editing.add_argument("--token", metavar="T", help="of the page on another --host; default: drawn at random")
    editing.set_defaults(run=_edit)
    mapped = commands.add_parser("robustness", help="errors of the pose that each grasp bears, against perception's")
    mapped.add_argument("workpiece", metavar="WORKPIECE")
    mapped.add_argument("--gripper", metavar="G", help="default: that of the table")
    mapped.add_argument("--grasps", default="all", metavar="NAMES", help="all, or names with commas (default all)")
    mapped.add_argument(
        "--table", type=some_path, metavar="FILE", help="grasp points; default: the workpiece's grasps.yaml"
    )
    mapped.add_argument(
        "--errors",
        type=some_path,
        metavar="FILE",
        help="evaluation.json; default: out/evaluate/WORKPIECE/, where it is",
    )
    mapped.add_argument("--workers", type=integer(1, 256), default=1, metavar="K", help="processes (default 1)")
    mapped.add_argument("--out", type=folder_to_write, metavar="DIR", help="default: out/robustness-WORKPIECE")
    mapped.set_defaults(run=_robustness)
    for command in (importing, exporting, checking, sampling):
        help_text = f"default: that of the workpiece's grasps.yaml, {GRIPPER} where there is none"
        command.add_argument("--gripper", metavar="G", help=help_text)
    for command in (importing, exporting):
        command.add_argument(
            "--out", type=file_to_write, metavar="FILE", help="write there; default: to standard output"
        )
        command.add_argument(
            "--tool",
            nargs=6,
            type=number(-1000, 1000),
            default=[0.0] * 6,
            metavar=SIX,
            help="our tool centre point in the other program's gripper frame, in [m] and [deg]; default: that frame",
        )


def main(args: argparse.Namespace) -> int:
    """Run the command; returns the exit code."""
    run: Callable[[argparse.Namespace], int] = args.run
    return run(args)


def _import(args: argparse.Namespace) -> int:
    workpiece, gripper = _both(args)
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
    workpiece, gripper = _both(args)
    text = isaac_grasps_text(load_grasps(workpiece, gripper), workpiece.name, gripper.name, _tool(args))
    return _write(text, args.out)


def _check(args: argparse.Namespace) -> int:
    from pickproof.scenarios.grasp_trials.check import check_grasp_points, check_table

    workpiece, gripper = _both(args)
    rows, resting = check_grasp_points(workpiece, gripper, load_grasps(workpiece, gripper).points)
    if args.json:
        print(json.dumps({"workpiece": workpiece.name, "gripper": gripper.name, "resting": resting, "trials": rows}))
    else:
        Console().print(check_table(rows, resting))
    return 0


def _edit(args: argparse.Namespace) -> int:
    from pickproof.scenarios.grasp_editor.editor import GraspEditor

    workpiece = load_workpiece(args.workpiece)
    path = args.grasps or workpiece.folder / "grasps.yaml"
    if path.exists() and not path.is_file():
        raise InputError("command line", "--grasps", str(path), "a regular file")
    if path.is_file() and path.stat().st_size:
        read_yaml(path)  # what is no YAML is no table that can be edited
    gripper = load_gripper(args.gripper or _gripper_of(path))
    token = args.token or (None if args.host == HOST else secrets.token_urlsafe(16))
    editor = GraspEditor(workpiece, gripper, path, args.port, args.host, token)
    Console().print(f"editing {path}\nopen {editor.url} in a browser; Ctrl-C ends", soft_wrap=True)
    try:
        threading.Event().wait()
    except KeyboardInterrupt:
        unsaved = editor.document.changed
        editor.close()
        if unsaved:
            print(f"pickproof: changes of {path} were not saved", file=sys.stderr)
    return 0


def _both(args: argparse.Namespace) -> tuple[Workpiece, Gripper]:
    """The workpiece, and the gripper that was named or that its table is for."""
    workpiece = load_workpiece(args.workpiece)
    return workpiece, load_gripper(args.gripper or _gripper_of(workpiece.folder / "grasps.yaml"))


def _gripper_of(path: Path) -> str:
    """The gripper that a table is for, as far as the table can be read."""
    try:
        return str(read_yaml(path).get("gripper", GRIPPER))
    except InputError:
        return GRIPPER  # whoever needs the table says what is wrong with it


def _sample(args: argparse.Namespace) -> int:
    from pickproof.grasping.sample import propose
    from pickproof.scenarios.grasp_trials.check import tried

    workpiece, gripper = _both(args)
    proposals = propose(workpiece, gripper, args.count, np.random.default_rng(args.seed))
    points = tried(workpiece, gripper, proposals, args.least)
    if not points:
        raise InputError("command line", "workpiece", workpiece.name, f"one that {gripper.name} can hold")
    how = f"{workpiece.name} --gripper {gripper.name} --count {args.count} --seed {args.seed} --least {args.least:g}"
    comment = f"Proposed by `pickproof grasps sample {how}`.\nSchema: docs/reference/grasps-file.md."
    return _write(table_text(points, gripper.name, comment), args.out)


def _robustness(args: argparse.Namespace) -> int:
    from pickproof.scenarios.campaign.parallel_map import mapping
    from pickproof.scenarios.files.atomic import write_json
    from pickproof.scenarios.grasp_trials.robustness import Task, document, named, read_errors, try_robustness, verdict
    from pickproof.scenarios.grasp_trials.robustness_report import plot_robustness, robustness_table

    workpiece = load_workpiece(args.workpiece)
    table = args.table or workpiece.folder / "grasps.yaml"
    gripper = load_gripper(args.gripper or _gripper_of(table))
    enabled = [p for p in load_grasps(workpiece, gripper, table).points if p.gripper == gripper.name]
    points = named(enabled, args.grasps, table)
    measured = Path("out") / "evaluate" / workpiece.name / "evaluation.json"
    source = args.errors or (measured if measured.is_file() else None)
    errors = read_errors(source) if source else None
    console, tasks = Console(), [Task(workpiece.name, gripper.name, p) for p in points]
    with mapping(args.workers) as run:
        grasps = list(track(run(try_robustness, tasks), "grasps", len(tasks), console=console))
    out = args.out or Path("out") / f"robustness-{workpiece.name}"
    write_json(out / "robustness.json", document(grasps, errors))
    plot_robustness(grasps, errors, f"{workpiece.name} with {gripper.name}", out / "robustness.png")
    console.print(robustness_table(grasps, errors))
    for grasp in grasps:
        console.print(f"{grasp.grasp}: {verdict(grasp, errors)}", soft_wrap=True, highlight=False)
    if errors is None:
        console.print(f"errors of perception are not known: pickproof evaluate {workpiece.name}", soft_wrap=True)
    console.print(f"wrote robustness.json and robustness.png to {out}", soft_wrap=True)
    return 0


def _tool(args: argparse.Namespace) -> Array:
    return from_rpy(args.tool[:3], np.deg2rad(args.tool[3:]))


def _write(text: str, path: Path | None) -> int:
    if path is None:
        print(text, end="")
    else:
        write_whole(path, text)
        print(f"wrote {path}")
    return 0
