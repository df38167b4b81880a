"""`pickproof grasps check WORKPIECE`: which grasps hold a lone workpiece, in every resting pose."""

from __future__ import annotations

import json as json_module
from typing import Annotated

from pickproof.scenarios.commands.arguments import WorkpieceName, about
from pickproof.scenarios.commands.grasps.arguments import GripperName


def check(
    workpiece: WorkpieceName,
    /,
    *,
    gripper: GripperName = None,
    json: Annotated[bool, about("print the trials as JSON")] = False,
) -> int:
    """`pickproof grasps check WORKPIECE`."""
    from rich.console import Console

    from pickproof.grasping.grasp_points import load_grasps
    from pickproof.scenarios.grasp_trials.check import check_grasp_points, check_table
    from pickproof.scenarios.grasp_trials.table_files import workpiece_and_gripper

    part, hand = workpiece_and_gripper(workpiece, gripper)
    rows, resting = check_grasp_points(part, hand, load_grasps(part, hand).points)
    if json:
        found = {"workpiece": part.name, "gripper": hand.name, "resting": resting, "trials": rows}
        print(json_module.dumps(found))
    else:
        Console().print(check_table(rows, resting))
    return 0
