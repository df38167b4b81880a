"""`pickproof grasps import WORKPIECE FILE`: an isaac_grasp file as grasps.yaml."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pickproof.scenarios.commands.arguments import SOME_PATH, WorkpieceName, about
from pickproof.scenarios.commands.grasps.arguments import (
    NO_OFFSET,
    GripperName,
    TextFile,
    Tool,
    tool_transform,
    write_text,
)


def import_(
    workpiece: WorkpieceName,
    file: Annotated[Path, SOME_PATH, about("an isaac_grasp file, format version 1.0")],
    /,
    *,
    gripper: GripperName = None,
    out: TextFile = None,
    tool: Tool = NO_OFFSET,
) -> int:
    """`pickproof grasps import WORKPIECE FILE`."""
    from pickproof.scenarios.files.grasps_text import table_text
    from pickproof.scenarios.grasp_trials.table_files import imported, workpiece_and_gripper

    part, hand = workpiece_and_gripper(workpiece, gripper)
    return write_text(table_text(imported(file, tool_transform(tool), part, hand), hand.name), out)
