"""The page and the record of an onboarding."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from pickproof.cell.html_page import page_template, png_uri
from pickproof.cell.physics.step_cost import PILE
from pickproof.cell.symmetry.symmetry_search import Degrees, FoundSymmetry
from pickproof.cell.workpiece.decompose import Pieces
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.scenarios.onboarding.part import Held, Part, is_infinite, matrix_rows, scenario_text
from pickproof.scenarios.onboarding.search_trial import SearchTrial
from pickproof.scenarios.reporting.part_pictures import axes_picture, grasps_picture, pieces_picture, resting_picture


@dataclass(frozen=True)
class Onboarded:
    """What onboarding found of a part.

    Attributes:
        part, workpiece: as measured, and as the other commands read it.
        held: gripper and grasp points.
        trial: what the search for its poses finds.
        cost: processor time [s] of a physics step of a small pile.
    """

    part: Part
    workpiece: Workpiece
    held: Held
    trial: SearchTrial
    cost: float


def page(known: Onboarded, fields: Mapping[str, Any], reasons: Mapping[str, str], source: str, seconds: float) -> str:
    """One self-contained HTML page."""
    part, workpiece, held = known.part, known.workpiece, known.held

    pictures = {
        "axes": png_uri(axes_picture(part.mesh, part.found, part.degrees)),
        "resting": png_uri(resting_picture(part.mesh, part.resting)) if part.resting else "",
        "pieces": png_uri(pieces_picture(part.mesh, part.pieces.pieces)),
        "grasps": png_uri(grasps_picture(part.mesh, held.points, held.gripper)) if held.gripper else "",
    }
    return page_template("pickproof.scenarios.onboarding", "onboard.html.j2").render(
        part=part,
        workpiece=workpiece,
        held=held,
        trial=known.trial,
        reasons=reasons,
        pictures=pictures,
        symmetry=symmetry_lines(part.found),
        told=part.degrees != part.found.degrees,
        size=" x ".join(f"{1000 * e:.1f}" for e in workpiece.extents),
        com=" ".join(f"{1000 * c:.2f}" for c in workpiece.com),
        inertia=[" ".join(f"{1e6 * x:.3f}" for x in row) for row in workpiece.inertia],
        rows=[" ".join(f"{x:.6g}" for x in row) for row in matrix_rows(part.found.T_part_cad)],
        scenario=scenario_text(dict(fields)) if fields else "",
        source=source,
        seconds=seconds,
        cost=cost_text(part.pieces, known.cost),
    )


def record(known: Onboarded, source: str, unit: str) -> dict[str, Any]:
    """What machines read: where the part's frame is in the user's CAD, and every residual."""
    part, workpiece, held = known.part, known.workpiece, known.held
    return {
        "source": source,
        "unit": unit,
        "notes": list(part.notes),
        "repair": {"volume_share": part.volume_change, "moved_mm": 1000 * part.moved},
        "T_part_cad": matrix_rows(part.found.T_part_cad),
        "mass": workpiece.mass,
        "com": np.round(workpiece.com, 9).tolist(),
        "inertia": workpiece.inertia.tolist(),
        "symmetry": {
            "degrees": list(part.degrees),
            "found": list(part.found.degrees),
            "residual_mm": 1000 * part.found.match.residual,
            "tolerance_mm": 1000 * part.found.tolerance,
            "missing": part.found.missing,
            "near": [
                {
                    "axis": np.round(turn.direction, 6).tolist(),
                    "order": turn.order,
                    "residual_mm": 1000 * turn.match.residual,
                    "share": turn.match.share,
                }
                for turn in part.found.near
            ],
        },
        "pieces": {
            "how": part.pieces.how,
            "outside_mm": 1000 * part.pieces.outside,
            "beyond_mm": 1000 * part.pieces.beyond,
            "felt_mm": 1000 * part.pieces.felt,
            "bound_mm": 1000 * part.pieces.bound,
            "count": len(part.pieces.pieces),
            "step_ms": 1000 * known.cost,
        },
        "resting": [
            {"probability": pose.probability, "T_plane_part": matrix_rows(pose.T_plane_part)} for pose in part.resting
        ],
        "gripper": held.gripper.name if held.gripper else None,
        "physics": asdict(held.convergence) if held.convergence else None,
        "grasps": len(held.points),
        "search": known.trial.record(),
    }


def cost_text(pieces: Pieces, cost: float) -> str:
    """What the collision pieces cost, in words."""
    return (
        f"{len(pieces.pieces)} collision pieces; a physics step of {PILE} parts in a pile takes {1000 * cost:.2f} ms "
        "of this machine"
    )


def symmetry_lines(found: FoundSymmetry) -> list[str]:
    """What was found, a line each."""
    counts = f"{1000 * found.tolerance:.2f} mm is what the camera can tell"
    lines = [f"symmetry: none; {counts}"]
    if any(found.degrees):
        lines = [
            f"symmetry: {listed_degrees(found.degrees)}, off by {1000 * found.match.residual:.2f} mm at most; {counts}"
        ]
    for turn in found.near:
        axis = " ".join(f"{x:.2f}" for x in turn.direction)
        what = "any turn" if turn.order == 0 else f"{360 / turn.order:.4g} deg"
        lines.append(
            f"nearly symmetric: {what} about ({axis}), off by {1000 * turn.match.residual:.2f} mm at most on "
            f"{100 * turn.match.share:.1f} % of the surface; perception will confuse these"
        )
    return lines + ([found.missing] if found.missing else [])


def listed_degrees(degrees: Degrees) -> str:
    """The symmetries about x, y and z in words."""
    said = [
        f"any turn about {axis}" if is_infinite(d) else f"{d:.4g} deg about {axis}"
        for axis, d in zip("xyz", degrees, strict=True)
        if d > 0
    ]
    return ", ".join(said) or "none"
