"""`pickproof onboard`: a user's CAD made a workpiece, with grasps, a cell for it and a page that shows all of it."""

from __future__ import annotations

import argparse
import re
import shlex
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import trimesh
from rich.console import Console

from pickproof.cell.child_process import FOLDERS, child_environment
from pickproof.cell.errors import InputError
from pickproof.cell.mesh.check import UNITS
from pickproof.cell.mesh.read import read_checked
from pickproof.cell.physics.convergence import FEWEST
from pickproof.cell.physics.step_cost import step_cost
from pickproof.cell.symmetry.symmetry_search import Degrees, FoundSymmetry
from pickproof.cell.workpiece.piece_errors import PROBE
from pickproof.cell.workpiece.workpiece import SHIPPED, load_workpiece, search_path
from pickproof.scenarios.commands.arguments import integer, number, some_path
from pickproof.scenarios.config.scenario import OF_WORKPIECE, load_scenario
from pickproof.scenarios.files.atomic import write_json, write_whole
from pickproof.scenarios.files.grasps_text import table_text
from pickproof.scenarios.onboarding.page import cost_text, listed_degrees, page, record, symmetry_lines
from pickproof.scenarios.onboarding.part import (
    MATERIALS,
    claimed,
    find_converged_grasps,
    scenario_fields,
    scenario_text,
    search_symmetry,
    understand,
    write_workpiece,
)
from pickproof.scenarios.picking.workcell import check_inputs

DEFAULT = Path("workpieces")
PAGE, RECORD = "onboard.html", "onboard.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of the command `onboard`."""
    parser.add_argument("mesh", type=some_path, metavar="MESH", help="STL, OBJ, PLY, GLB, or STEP with pickproof[step]")
    parser.add_argument("--unit", required=True, choices=list(UNITS), help="of the lengths in the file")
    parser.add_argument(
        "--body", type=integer(1, 500), metavar="N", help="of bodies in the file that do not touch: 1 for the largest"
    )
    parser.add_argument("--name", required=True, help="of the workpiece: letters, digits, _ and -")
    parser.add_argument("--material", default="steel", choices=list(MATERIALS), help="default steel")
    parser.add_argument(
        "--symmetry", nargs=3, type=number(0, 360), metavar=("DX", "DY", "DZ"),
        help="smallest turn about x, y, z of the part's frame that changes nothing, 0 for none; default: as found",
    )  # fmt: skip
    parser.add_argument("--yes", action="store_true", help="take the symmetry that is found without asking")
    parser.add_argument("--replace", action="store_true", help="write over a workpiece of this name, weights included")
    parser.set_defaults(makes_folder=True)


def main(args: argparse.Namespace) -> int:
    """Run the command; returns the exit code."""
    begun, console = time.monotonic(), Console()
    root, target = _target(args)
    if args.symmetry is not None:
        _three(args.symmetry, "--symmetry")  # before the mesh is looked at
    say = _sayer(console)
    checked = read_checked(args.mesh, args.unit, args.body)
    mesh, found = search_symmetry(checked)
    say(
        f"mesh: {len(mesh.faces)} faces, {_millimetres(mesh)}, {1e6 * mesh.volume:.2f} cm3"
        + "".join(f"; {n}" for n in checked.notes)
    )
    for line in symmetry_lines(found):
        say(line)
    degrees = _decided(args, found)
    if degrees != found.degrees:
        off = claimed(mesh, found, degrees)
        say(f"symmetry taken as told: {listed_degrees(degrees)}; off by {1000 * off:.2f} mm at most")
        if off > found.tolerance:
            say("the camera can tell that: poses will be taken for right that are not")
    part = understand(args.name, args.material, checked, mesh, found, degrees)
    ways = f"lies in {len(part.resting)} ways"
    say(f"in its own frame {_millimetres(part.mesh)}; weighs {part.mesh.mass:.4g} kg in {args.material}; {ways}")
    say(
        f"collision pieces: {part.pieces.how}; the part sticks out of them by {1000 * part.pieces.outside:.1f} mm "
        f"at most, they out of it by {1000 * part.pieces.felt:.1f} mm, where a ball of {2000 * PROBE:g} mm comes, "
        f"closed holes included by {1000 * part.pieces.beyond:.1f} mm; {1000 * part.pieces.bound:.1f} mm are allowed"
    )
    with tempfile.TemporaryDirectory(dir=root, prefix=".onboard-") as draft:
        folder = Path(draft) / args.name
        write_workpiece(part, folder)
        with child_environment({FOLDERS: draft}):
            workpiece = load_workpiece(args.name)
            cost = step_cost(workpiece, FEWEST)
            say(cost_text(part.pieces, cost))
            held = find_converged_grasps(workpiece, part.heap, say)
            fields, reasons = scenario_fields(workpiece, held, part.heap)
            if held.gripper is not None:
                comment = f"Proposed by `pickproof onboard` for {held.gripper.name}; schema: docs/grasping.md."
                text = table_text(list(held.points), held.gripper.name, comment)
                (folder / "grasps.yaml").write_text(text, encoding="utf-8")
            if fields:
                (folder / OF_WORKPIECE).write_text(scenario_text(fields), encoding="utf-8")
                check_inputs(load_scenario(args.name), frozenset({"perception"}))
        for what, why in reasons.items():
            say(f"{what}: {why}")
        seconds = time.monotonic() - begun
        write_whole(folder / PAGE, page(part, workpiece, held, fields, reasons, args.mesh.name, seconds, cost))
        write_json(folder / RECORD, record(part, workpiece, held, args.mesh.name, args.unit, cost))
        if target.exists():
            shutil.rmtree(target)
        folder.rename(target)
    console.print(f"wrote {target}; look at {target / PAGE}", soft_wrap=True)
    where = f" --workpieces {shlex.quote(str(root))}"
    console.print(f"next: pickproof train {args.name} --minutes 30{where}", soft_wrap=True)
    if fields:
        console.print(f"      pickproof run {args.name} --oracle perception --episodes 2{where}", soft_wrap=True)
    return 0


def _target(args: argparse.Namespace) -> tuple[Path, Path]:
    """The folder of workpieces and that of the new one."""
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", args.name):
        raise InputError("command line", "--name", args.name, "letters, digits, _ and -")
    root = search_path()[0]
    if root == SHIPPED:
        root = DEFAULT
    target = root / args.name
    if target.exists() and not args.replace:
        raise InputError("command line", "--name", str(target), "a name that is free there, or --replace")
    try:
        root.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=root):
            pass
    except OSError as error:
        raise InputError(
            "command line", "--workpieces", str(root), f"a folder to write in ({error.strerror})"
        ) from None
    if (SHIPPED / args.name).is_dir():
        print(f"{args.name}: this one will come before the shipped one, wherever {root} is searched", file=sys.stderr)
    return root, target


def _decided(args: argparse.Namespace, found: FoundSymmetry) -> Degrees:
    """The symmetry as told, as found, or as answered."""
    if args.symmetry is not None:
        return _three(args.symmetry, "--symmetry")
    if args.yes:
        return found.degrees
    try:
        answer = input("Is this symmetry right? Enter for yes, or d_x d_y d_z in degrees (0 for none): ").split()
    except EOFError:
        raise InputError("command line", "--yes", "no answer", "--yes, or --symmetry DX DY DZ") from None
    if not answer or answer[0].lower() in ("y", "yes"):
        return found.degrees
    try:
        return _three([float(word) for word in answer], "d_x d_y d_z")
    except ValueError:
        raise InputError("answer", "d_x d_y d_z", " ".join(answer), "three numbers") from None


def _three(numbers: list[float], field: str) -> Degrees:
    if len(numbers) != 3 or not all(0 <= d < 360 for d in numbers):
        raise InputError("command line", field, numbers, "three angles from 0 to 360 degrees, 0 for none")
    return numbers[0], numbers[1], numbers[2]


def _millimetres(mesh: trimesh.Trimesh) -> str:
    return " x ".join(f"{1000 * e:.1f}" for e in mesh.extents) + " mm"


def _sayer(console: Console) -> Callable[[str], None]:
    def say(text: str) -> None:
        console.print(text, soft_wrap=True, highlight=False)
        sys.stdout.flush()

    return say
