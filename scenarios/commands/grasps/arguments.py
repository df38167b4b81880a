"""Options that several of the `pickproof grasps` commands share."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pickproof.scenarios.commands.arguments import FILE_TO_WRITE, about, parse_number, read_by

if TYPE_CHECKING:
    from pickproof.cell.frames import Array

GripperName = Annotated[str | None, about("default: that of the workpiece's grasps.yaml, jaw_v1 where there is none")]
TextFile = Annotated[Path | None, FILE_TO_WRITE, about("output file; default: standard output")]
Six = tuple[float, float, float, float, float, float]
Tool = Annotated[
    Six,
    read_by(parse_number(-1000, 1000), many=True),
    about("X Y Z ROLL PITCH YAW: the TCP in the other program's gripper frame, in m and degrees; default: that frame"),
]
NO_OFFSET: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def tool_transform(tool: Six) -> Array:
    """T_hand_tool of --tool."""
    import numpy as np

    from pickproof.cell.frames import from_rpy

    return from_rpy(list(tool[:3]), np.deg2rad(tool[3:]))


def write_text(text: str, path: Path | None) -> int:
    """Print a text, or write it to a file and report that."""
    from pickproof.scenarios.files.atomic import write_whole

    if path is None:
        print(text, end="")
    else:
        write_whole(path, text)
        print(f"wrote {path}")
    return 0
