"""`pickproof grasps export WORKPIECE`: grasps.yaml as an isaac_grasp file."""

from __future__ import annotations

from pickproof.scenarios.commands.arguments import WorkpieceName
from pickproof.scenarios.commands.grasps.arguments import (
    NO_OFFSET,
    GripperName,
    TextFile,
    Tool,
    tool_transform,
    write_text,
)


def export(
    workpiece: WorkpieceName, /, *, gripper: GripperName = None, out: TextFile = None, tool: Tool = NO_OFFSET
) -> int:
    """`pickproof grasps export WORKPIECE`."""
    from pickproof.grasping.grasp_points import load_grasps
    from pickproof.grasping.isaac_grasp import isaac_grasps_text
    from pickproof.scenarios.grasp_trials.table_files import workpiece_and_gripper

    part, hand = workpiece_and_gripper(workpiece, gripper)
    return write_text(isaac_grasps_text(load_grasps(part, hand), part.name, hand.name, tool_transform(tool)), out)
