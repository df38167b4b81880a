"""The steps of `pickproof onboard`: from a mesh file to a workpiece with grasps, a cell for it, and a page."""

from __future__ import annotations

import re
import shutil
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import trimesh

from pickproof.cell.child_process import FOLDERS, child_environment
from pickproof.cell.errors import InputError
from pickproof.cell.mesh.read import read_checked
from pickproof.cell.physics.convergence import FEWEST
from pickproof.cell.physics.step_cost import step_cost
from pickproof.cell.symmetry.symmetry_search import Degrees, FoundSymmetry
from pickproof.cell.workpiece.piece_errors import PROBE
from pickproof.cell.workpiece.workpiece import load_workpiece, search_path
from pickproof.scenarios.config.scenario import OF_WORKPIECE, load_scenario
from pickproof.scenarios.config.shipped import WORKPIECES
from pickproof.scenarios.files.atomic import write_json, write_whole
from pickproof.scenarios.files.grasps_text import table_text
from pickproof.scenarios.onboarding.page import Onboarded, cost_text, listed_degrees, page, record, symmetry_lines
from pickproof.scenarios.onboarding.part import (
    Part,
    claimed,
    find_converged_grasps,
    scenario_fields,
    scenario_text,
    search_symmetry,
    understand,
    write_workpiece,
)
from pickproof.scenarios.onboarding.search_trial import SearchTrial
from pickproof.scenarios.picking.workcell import check_inputs

DEFAULT = Path("workpieces")
PAGE, RECORD = "onboard.html", "onboard.json"

Say = Callable[[str], None]
Decide = Callable[[FoundSymmetry], Degrees]


@dataclass(frozen=True)
class Onboarding:
    """What is to become a workpiece.

    Attributes:
        mesh: the CAD file, with lengths in `unit`.
        name: of the workpiece; material: one of MATERIALS.
        body: of bodies in the file that do not touch the one that is meant, 1 for the largest; None if there is one.
    """

    mesh: Path
    unit: str
    name: str
    material: str
    body: int | None = None


@dataclass(frozen=True)
class Target:
    """Where the workpiece is written: the folder of workpieces, and its own folder there."""

    root: Path
    folder: Path

    @property
    def hides_shipped(self) -> bool:
        """A shipped workpiece has the same name and is found later than this one."""
        return (WORKPIECES / self.folder.name).is_dir()


def target_of(name: str, replace: bool) -> Target:
    """The folder that a workpiece of this name gets; the folder of workpieces is made.

    Raises:
        InputError: not a valid name, one that is taken, or a folder that cannot be written.
    """
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", name):
        raise InputError("command line", "--name", name, "letters, digits, _ and -")
    root = search_path()[0]
    if root == WORKPIECES:
        root = DEFAULT
    folder = root / name
    if folder.exists() and not replace:
        raise InputError("command line", "--name", str(folder), "a name that is free there, or --replace")
    try:
        root.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=root):
            pass
    except OSError as error:
        valid = f"a folder to write in ({error.strerror})"
        raise InputError("command line", "--workpieces", str(root), valid) from None
    return Target(root, folder)


def onboard(asked: Onboarding, target: Target, decide: Decide, say: Say) -> bool:
    """Write the workpiece, whole or not at all; returns whether a cell could be proposed for it.

    Args:
        decide: the symmetry to be taken, given what was found.
        say: told each step in words.

    Raises:
        InputError: the mesh cannot be used.
    """
    begun = time.monotonic()
    part = _understand(asked, decide, say)
    with tempfile.TemporaryDirectory(dir=target.root, prefix=".onboard-") as draft:
        folder = Path(draft) / asked.name
        write_workpiece(part, folder)
        with child_environment({FOLDERS: draft}):
            has_cell = _equip(asked, part, folder, begun, say)
        if target.folder.exists():
            shutil.rmtree(target.folder)
        folder.rename(target.folder)
    return has_cell


def three_angles(numbers: list[float], field: str) -> Degrees:
    """Three angles from 0 to below 360 degrees.

    Raises:
        InputError: they are others.
    """
    if len(numbers) != 3 or not all(0 <= d < 360 for d in numbers):
        raise InputError("command line", field, numbers, "three angles from 0 to 360 degrees, 0 for none")
    return numbers[0], numbers[1], numbers[2]


def _understand(asked: Onboarding, decide: Decide, say: Say) -> Part:
    """Mesh, symmetry, mass, resting poses and collision pieces."""
    checked = read_checked(asked.mesh, asked.unit, asked.body)
    mesh, found = search_symmetry(checked)
    say(
        f"mesh: {len(mesh.faces)} faces, {_millimetres(mesh)}, {1e6 * mesh.volume:.2f} cm3"
        + "".join(f"; {n}" for n in checked.notes)
    )
    for line in symmetry_lines(found):
        say(line)
    degrees = decide(found)
    if degrees != found.degrees:
        off = claimed(mesh, found, degrees)
        say(f"symmetry taken as told: {listed_degrees(degrees)}; off by {1000 * off:.2f} mm at most")
        if off > found.tolerance:
            say("the camera can see the difference: wrong poses will be taken for right ones")
    part = understand(asked.name, asked.material, checked, mesh, found, degrees)
    ways = f"has {len(part.resting)} resting poses"
    say(f"in its own frame {_millimetres(part.mesh)}; weighs {part.mesh.mass:.4g} kg in {asked.material}; {ways}")
    say(
        f"collision pieces: {part.pieces.how}; the part sticks out of them by {1000 * part.pieces.outside:.1f} mm "
        f"at most, they out of it by {1000 * part.pieces.felt:.1f} mm, where a ball of {2000 * PROBE:g} mm comes, "
        f"closed holes included by {1000 * part.pieces.beyond:.1f} mm; {1000 * part.pieces.bound:.1f} mm are allowed"
    )
    return part


def _equip(asked: Onboarding, part: Part, folder: Path, begun: float, say: Say) -> bool:
    """Add grasps, a cell, the page and the record; returns whether there is a cell."""
    workpiece = load_workpiece(asked.name)
    cost = step_cost(workpiece, FEWEST)
    say(cost_text(part.pieces, cost))
    held = find_converged_grasps(workpiece, part.heap, say)
    fields, reasons = scenario_fields(workpiece, held, part.heap)
    if held.gripper is not None:
        comment = f"Proposed by `pickproof onboard` for {held.gripper.name}; schema: docs/reference/grasps-file.md."
        text = table_text(list(held.points), held.gripper.name, comment)
        (folder / "grasps.yaml").write_text(text, encoding="utf-8")
    if fields:
        (folder / OF_WORKPIECE).write_text(scenario_text(fields), encoding="utf-8")
        check_inputs(load_scenario(asked.name), frozenset({"perception"}))
    for what, why in reasons.items():
        say(f"{what}: {why}")
    trial = SearchTrial.of(workpiece, say)
    say(trial.line)
    seconds = time.monotonic() - begun
    known = Onboarded(part, workpiece, held, trial, cost)
    write_whole(folder / PAGE, page(known, fields, reasons, asked.mesh.name, seconds))
    write_json(folder / RECORD, record(known, asked.mesh.name, asked.unit) | {"cpu_s": time.process_time()})
    return bool(fields)


def _millimetres(mesh: trimesh.Trimesh) -> str:
    return " x ".join(f"{1000 * e:.1f}" for e in mesh.extents) + " mm"
