"""`pickproof onboard`: makes a workpiece from a CAD file, with grasps, a scenario and a page that shows the result."""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from pickproof.cell.errors import InputError
from pickproof.scenarios.commands.arguments import SOME_PATH, Flat, about, integer, parse_number, read_by

if TYPE_CHECKING:
    from pickproof.cell.symmetry.symmetry_search import Degrees, FoundSymmetry

Unit = Literal["mm", "cm", "m", "in", "um"]
"""`cell.mesh.check.UNITS` as a type; a test holds them equal."""
Material = Literal[
    "steel", "stainless", "cast_iron", "aluminium", "brass", "copper", "zinc", "titanium", "abs", "polyamide", "pom"
]
"""`onboarding.part.MATERIALS` as a type; a test holds them equal."""


@dataclass(frozen=True, kw_only=True)
class OnboardOptions:
    """Options of `pickproof onboard`."""

    unit: Annotated[Unit, about("of the lengths in the file")]
    body: Annotated[
        int | None, integer(1, 500), about("of bodies in the file that do not touch: 1 for the largest")
    ] = None
    name: Annotated[str, about("of the workpiece: letters, digits, _ and -")]
    material: Annotated[Material, about("of the part")] = "steel"
    symmetry: Annotated[
        tuple[float, float, float] | None,
        read_by(parse_number(0, 360), many=True),
        about("DX DY DZ: smallest symmetric rotation about x, y, z of the part frame, 0 for none; default: as found"),
    ] = None
    yes: Annotated[bool, about("accept the detected symmetry without a question")] = False
    replace: Annotated[bool, about("overwrite a workpiece of this name, weights included")] = False


def onboard(
    mesh: Annotated[Path, SOME_PATH, about("STL, OBJ, PLY, GLB, or STEP with pickproof[step]")],
    /,
    *,
    options: Annotated[OnboardOptions, Flat],
) -> int:
    """`pickproof onboard MESH --unit mm --name NAME`."""
    from rich.console import Console

    from pickproof.scenarios.onboarding.onboard import PAGE, Onboarding, target_of, three_angles
    from pickproof.scenarios.onboarding.onboard import onboard as onboard_part

    console = Console()

    def say(text: str) -> None:
        console.print(text, soft_wrap=True, highlight=False)
        sys.stdout.flush()

    target = target_of(options.name, options.replace)
    if target.hides_shipped:
        print(
            f"{options.name}: replaces the shipped workpiece of this name where {target.root} is on the search path",
            file=sys.stderr,
        )
    if options.symmetry is not None:
        three_angles(list(options.symmetry), "--symmetry")  # before the mesh is looked at
    asked = Onboarding(mesh, options.unit, options.name, options.material, options.body)
    has_cell = onboard_part(asked, target, lambda found: decided(options, found), say)
    say(f"wrote {target.folder}; look at {target.folder / PAGE}")
    where = f" --workpieces {shlex.quote(str(target.root))}"
    if has_cell:
        say(f"next: pickproof run {options.name} --episodes 2{where}")
    say(f"      pickproof train {options.name} --minutes 30{where}, where the search misses too much")
    return 0


def decided(options: OnboardOptions, found: FoundSymmetry) -> Degrees:
    """The symmetry as given, as found, or as answered."""
    from pickproof.scenarios.onboarding.onboard import three_angles

    if options.symmetry is not None:
        return three_angles(list(options.symmetry), "--symmetry")
    if options.yes:
        return found.degrees
    try:
        answer = input("Is this symmetry right? Enter for yes, or d_x d_y d_z in degrees (0 for none): ").split()
    except EOFError:
        raise InputError("command line", "--yes", "no answer", "--yes, or --symmetry DX DY DZ") from None
    if not answer or answer[0].lower() in ("y", "yes"):
        return found.degrees
    try:
        return three_angles([float(word) for word in answer], "d_x d_y d_z")
    except ValueError:
        raise InputError("answer", "d_x d_y d_z", " ".join(answer), "three numbers") from None
