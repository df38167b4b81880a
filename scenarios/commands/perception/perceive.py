"""`pickproof perceive WORKPIECE INPUT`: poses of workpieces in a user's depth image or point cloud."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Group
from cyclopts.validators import MutuallyExclusive

from pickproof.cell.errors import InputError
from pickproof.scenarios.commands.arguments import Flat, WorkpieceName, about, integer
from pickproof.scenarios.commands.invocation import command_line
from pickproof.scenarios.commands.perception.arguments import MethodName
from pickproof.scenarios.config.seeds import MAX_SEED

if TYPE_CHECKING:
    from pickproof.perception.own_images.user_frame import Options

_WHERE = Group("region of the workpieces, one of", validator=MutuallyExclusive())
Box = tuple[float, float, float, float, float, float]


@dataclass(frozen=True, kw_only=True)
class PerceiveOptions:
    """Options of `pickproof perceive`."""

    camera: Annotated[Path | None, about("intrinsics of a depth image, as JSON or YAML")] = None
    fx: Annotated[float | None, about("focal length in pixels; all four in place of --camera")] = None
    fy: Annotated[float | None, about("focal length in pixels")] = None
    cx: Annotated[float | None, about("principal point in pixels")] = None
    cy: Annotated[float | None, about("principal point in pixels")] = None
    depth_scale: Annotated[float | None, about("millimetres per count of a depth image")] = None
    camera_id: Annotated[int | None, about("entry of a scene_camera.json; default: by name")] = None
    depth_is: Annotated[Literal["z", "range"], about("range: the length of the ray")] = "z"
    unit: Annotated[
        Literal["cm", "m", "mm"] | None, about("unit of a cloud or of a floating-point depth image; default: m")
    ] = None
    camera_pose: Annotated[Path | None, about("file with the 4 x 4 T_world_camera of the input, in m")] = None
    sigma: Annotated[float | None, about("noise of a depth in m; default: measured in the input")] = None
    roi: Annotated[Box | None, about("X0 Y0 Z0 X1 Y1 Z1: box that holds the workpieces, in m", group=_WHERE)] = None
    bin: Annotated[Path | None, about("YAML with inner and T_world_bin, in m", group=_WHERE)] = None
    weights: Annotated[Path | None, about("default: the shipped ones")] = None
    method: MethodName = "auto"
    seed: Annotated[int, integer(0, MAX_SEED), about("seed of the voting points")] = 0
    json: Annotated[bool, about("print the poses as JSON")] = False
    out: Annotated[Path | None, about("output folder; default: out/perceive/WORKPIECE")] = None


def perceive(
    workpiece: WorkpieceName,
    input: Annotated[Path, about("depth: PNG, TIFF, NPY, NPZ; cloud: PLY, PCD, XYZ, PTS, NPY, NPZ")],
    /,
    *,
    options: Annotated[PerceiveOptions, Flat] = PerceiveOptions(),
) -> int:
    """`pickproof perceive WORKPIECE INPUT`."""
    from pickproof.perception.own_images.perceive import PerceptionRequest
    from pickproof.perception.own_images.perceive import perceive as perceive_input

    asked = PerceptionRequest(
        workpiece,
        input,
        _of_input(options),
        None if options.roi is None else list(options.roi),
        options.bin,
        options.weights,
        options.seed,
        options.out,
        command_line(),
        options.method,
    )
    found = perceive_input(asked, _warn)
    if options.json:
        print(json.dumps(found.document, indent=1))
        return 0
    K, noise = found.frame.intrinsics, 1e3 * found.frame.sigma
    print(f"{K.width} x {K.height} pixels, {found.pixels} of them of interest, noise {noise:.2f} mm")
    print(f"{len(found.document['poses'])} {workpiece} found in {found.document['seconds']:.2f} s")
    print(f"wrote {found.out / 'poses.json'} and {found.out / 'poses.png'}")
    return 0


def _warn(text: str) -> None:
    print(f"pickproof: warning: {text}", file=sys.stderr)


def _of_input(options: PerceiveOptions) -> Options:
    """The description of the input from the options."""
    from pickproof.perception.camera_files.check import check_sigma, check_step
    from pickproof.perception.data.bop_format import MM
    from pickproof.perception.own_images.user_frame import Options

    given = {name: getattr(options, name) for name in ("fx", "fy", "cx", "cy")}
    said = {name: value for name, value in given.items() if value is not None}
    if said and (len(said) < 4 or options.camera is not None):
        missing = ", ".join(f"--{name}" for name in given if name not in said)
        value = f"--camera and {', '.join(f'--{n}' for n in said)}" if options.camera else f"no {missing}"
        raise InputError("command line", "intrinsics", value, "--camera FILE, or all of --fx --fy --cx --cy")
    if options.depth_scale is not None:
        check_step(options.depth_scale / MM, "command line", "--depth-scale")
    if options.sigma is not None:
        check_sigma(options.sigma, "command line", "--sigma")
    return Options(
        camera=options.camera,
        focal=(said["fx"], said["fy"]) if said else None,
        centre=(said["cx"], said["cy"]) if said else None,
        camera_id=options.camera_id,
        depth_scale=options.depth_scale,
        unit=options.unit,
        depth_is=options.depth_is,
        pose=options.camera_pose,
        sigma=options.sigma,
    )
