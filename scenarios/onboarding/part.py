"""From a mesh file to a workpiece folder: the steps of `pickproof onboard`, each a value that the page shows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from pickproof.cell.config import yaml_text
from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.mesh.checked import Checked, as_trimesh
from pickproof.cell.symmetry.symmetry import INFINITE_BELOW_DEG, Symmetry
from pickproof.cell.symmetry.symmetry_search import Degrees, FoundSymmetry, check_degrees, find_symmetry
from pickproof.cell.workpiece.collision_pieces import CollisionBox, CollisionCylinder, CollisionHull
from pickproof.cell.workpiece.decompose import Pieces, decompose
from pickproof.cell.workpiece.resting_poses import Resting, resting_poses
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.grasping.grasp_points import GraspPoint
from pickproof.grasping.sample import propose
from pickproof.scenarios.grasp_trials.check import in_order_of_use, tried
from pickproof.scenarios.onboarding.cell_proposal import Heap, propose_cell, propose_heap, rank_grippers
from pickproof.scenarios.onboarding.convergence_check import Convergence, check_convergence

MATERIALS: dict[str, tuple[float, float, bool]] = {
    "steel": (7850, 0.5, True),
    "stainless": (7950, 0.45, False),
    "cast_iron": (7200, 0.5, True),
    "aluminium": (2700, 0.45, False),
    "brass": (8500, 0.4, False),
    "copper": (8900, 0.45, False),
    "zinc": (6600, 0.4, False),
    "titanium": (4430, 0.4, False),
    "abs": (1050, 0.35, False),
    "polyamide": (1140, 0.3, False),
    "pom": (1410, 0.25, False),
}
"""Density [kg/m3], dry friction on its like and on plastic, and whether a magnet holds it."""
ROLLING = 0.03
"""Of the radius: lever of rolling friction that keeps a turned part from rolling for ever."""
TOLERANCE = (0.005, 0.1)
"""T_e: [m], and share of the longest side, of which the smaller counts."""
SMALL = 0.015
"""Of the longest side, up to which a difference counts as none however noisy the camera is."""
PROPOSED, BATCH, ENOUGH, GRIPPERS = 72, 3, 24, 4
TRIES, GIVEN_UP = 96, 24
"""Grasps that are tried at most, of all grippers together, and of one while none holds: counts, not times, so that
every machine finds the same grasps."""


@dataclass(frozen=True)
class Part:
    """A part that is understood but for its grasps: mesh in [m] in its frame, and what was found of it.

    Attributes:
        notes, volume_change, moved: what was repaired, as in `Checked`.
    """

    name: str
    material: str
    mesh: trimesh.Trimesh
    notes: tuple[str, ...]
    volume_change: float
    moved: float
    found: FoundSymmetry
    degrees: Degrees
    pieces: Pieces
    resting: tuple[Resting, ...]
    heap: Heap


@dataclass(frozen=True)
class Held:
    """The gripper that was chosen, why, and its grasps, none where nothing holds; and all that was tried, in words.

    Attributes:
        convergence: of the physics in its trials, None before it was looked at.
    """

    gripper: Gripper | None
    why: str
    points: tuple[GraspPoint, ...]
    tried: tuple[str, ...]
    convergence: Convergence | None = None


def search_symmetry(checked: Checked) -> tuple[trimesh.Trimesh, FoundSymmetry]:
    """The mesh as it came, and its symmetry as the camera over a heap of its size can tell."""
    mesh = as_trimesh(checked)
    tolerance = min(propose_heap(np.asarray(mesh.extents)).tolerance, SMALL * float(mesh.extents.max()))
    return mesh, find_symmetry(mesh, tolerance)


def understand(
    name: str,
    material: str,
    checked: Checked,
    mesh: trimesh.Trimesh,
    found: FoundSymmetry,
    degrees: Degrees,
) -> Part:
    """Move the mesh to the part's frame, in which its sizes count, and find pieces, ways of lying and a heap."""
    mesh = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).apply_transform(found.T_part_cad)
    mesh.density = MATERIALS[material][0]
    symmetry = Symmetry(degrees)
    return Part(
        name=name,
        material=material,
        mesh=mesh,
        notes=tuple(checked.notes),
        volume_change=checked.volume_change,
        moved=checked.moved,
        found=found,
        degrees=degrees,
        pieces=decompose(mesh, symmetry.infinite_axis == 2),
        resting=tuple(resting_poses(mesh, symmetry)),
        heap=propose_heap(np.asarray(mesh.extents)),
    )


def claimed(mesh: trimesh.Trimesh, found: FoundSymmetry, degrees: Degrees) -> float:
    """Largest distance [m] between the part and itself under the symmetry that a user claims.

    Raises:
        InputError: the degrees make no finite group.
    """
    try:
        Symmetry(degrees)
    except ValueError:
        raise InputError("command line", "--symmetry", degrees, "a finite rotation group, as 180 0 120") from None
    moved = mesh.copy().apply_transform(found.T_part_cad)
    return check_degrees(moved, degrees, found.tolerance).residual


def write_workpiece(part: Part, folder: Path) -> None:
    """workpiece.yaml, the mesh and hulls in [mm]."""
    folder.mkdir(parents=True)
    scaled = trimesh.Trimesh(1000 * part.mesh.vertices, part.mesh.faces, process=False)
    scaled.export(folder / f"{part.name}.ply")
    density, friction, magnetic = MATERIALS[part.material]
    fields: dict[str, Any] = {
        "name": part.name,
        "mesh": f"{part.name}.ply",
        "mesh_unit": "mm",
        "material": part.material,
        "density": density,
        "friction": friction,
        "magnetic": magnetic,
        "symmetry": {"degrees": [round(d, 9) for d in part.degrees]},
    }
    axis = Symmetry(part.degrees).infinite_axis
    if axis is not None:
        fields["rolling_friction"] = round(ROLLING * float(np.sort(part.mesh.extents)[1]) / 2, 5)
    boxes = [p for p in part.pieces.pieces if isinstance(p, CollisionBox)]
    cylinders = [p for p in part.pieces.pieces if isinstance(p, CollisionCylinder)]
    hulls = [p for p in part.pieces.pieces if isinstance(p, CollisionHull)]
    for key, pieces in (("collision_boxes", boxes), ("collision_cylinders", cylinders)):
        if pieces:
            fields[key] = [_rounded(piece.model_dump(mode="json", exclude_defaults=True)) for piece in pieces]
    if hulls:
        fields["collision_hulls"] = "hulls.obj"
        lines = []
        for i, hull in enumerate(hulls):
            lines += [f"o hull{i}", *(f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in 1000 * hull.vertices)]
        (folder / "hulls.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")
    heap = part.heap
    fields["heap"] = {
        "bin_inner": list(heap.bin_inner),
        "count": list(heap.count),
        "camera_distance": heap.camera_distance,
    }
    fields["tolerance"] = round(min(TOLERANCE[0], TOLERANCE[1] * float(part.mesh.extents.max())), 5)
    head = "# Written by `pickproof onboard`; lengths in [m]. docs/explanation/onboarding.md says how it was found.\n"
    (folder / "workpiece.yaml").write_text(head + yaml_text(fields), encoding="utf-8")


def find_converged_grasps(workpiece: Workpiece, heap: Heap, say: Callable[[str], None]) -> Held:
    """As `find_grasps`, with as many iterations of the contact solver as make the trials sure."""
    held = find_grasps(workpiece, heap, say)
    if held.gripper is None:
        return held
    convergence = check_convergence(workpiece, held.gripper, held.points)
    say(convergence.text)
    if convergence.raised:
        held = find_grasps(workpiece, heap, say, convergence.iterations)
    return replace(held, convergence=convergence)


def find_grasps(
    workpiece: Workpiece, heap: Heap, say: Callable[[str], None], iterations: int | None = None
) -> Held:
    """Grasps from the CAD that hold in the physics, by the most suitable gripper that has any.

    Args:
        iterations: of the contact solver, as in `TrialCell`.
    """
    words: list[str] = []
    left = TRIES
    gripper, why, best = None, "", list[GraspPoint]()
    candidates = [c for c in rank_grippers(workpiece, heap.bin_inner[2]) if c.fits]
    for choice in candidates[:GRIPPERS]:
        proposed = in_order_of_use(
            workpiece, choice.gripper, propose(workpiece, choice.gripper, PROPOSED, np.random.default_rng(0))
        )
        held: list[GraspPoint] = []
        of_this = 0
        while of_this < min(len(proposed), left if held else min(left, GIVEN_UP)) and len(held) < ENOUGH:
            batch = proposed[of_this : min(of_this + BATCH, left)]
            held += tried(workpiece, choice.gripper, batch, iterations=iterations)
            of_this += len(batch)
        left -= of_this
        counts = f"{len(proposed)} grasps proposed, {of_this} tried, {len(held)} hold"
        words.append(f"{choice.gripper.name}: {choice.reason}; {counts}")
        say(words[-1])
        if len(held) > len(best):
            gripper, why, best = choice.gripper, words[-1], sorted(held, key=lambda p: -p.robustness)
        if len(held) >= BATCH or not left:
            break
    words += [f"{c.gripper.name}: {c.reason}" for c in rank_grippers(workpiece, heap.bin_inner[2]) if not c.fits]
    return Held(gripper, why, tuple(best), tuple(words))


def scenario_fields(workpiece: Workpiece, held: Held, heap: Heap) -> tuple[dict[str, Any], dict[str, str]]:
    """A scenario for the part, and the reasons; empty where no gripper or no arm does."""
    if held.gripper is None:
        return {}, {"gripper": "no shipped gripper holds it; docs/reference/grasps-file.md says how to write grasps"}
    fields, reasons = propose_cell(workpiece, held.gripper, heap)
    if fields:
        fields = {"name": workpiece.name, "workpiece": workpiece.name, "seed": 0, **fields}
    if held.convergence is not None:
        reasons["physics"] = held.convergence.text
        if fields and held.convergence.raised:
            fields["physics"] = {"solver_iterations": held.convergence.iterations}
    return fields, {"bin and camera": heap.reason, "gripper": held.why, **reasons}


def scenario_text(fields: dict[str, Any]) -> str:
    """The text of scenario.yaml."""
    return (
        "# Written by `pickproof onboard`. Fields left out take the defaults of scenarios/config/scenario.py.\n"
        + yaml_text(fields)
    )


def is_infinite(degrees: float) -> bool:
    """Whether d counts as any turn, being finer than T_s."""
    return 0 < degrees <= INFINITE_BELOW_DEG


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(v) for key, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_rounded(v) for v in value]
    return round(value, 7) if isinstance(value, float) else value


def matrix_rows(T: Array) -> Sequence[Sequence[float]]:
    """A transform (4, 4) as rounded rows."""
    return [[round(float(x), 9) + 0.0 for x in row] for row in T]
