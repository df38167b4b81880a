"""`pickproof grasps sample WORKPIECE`: grasp points proposed from the CAD, tried in the physics."""

from __future__ import annotations

from typing import Annotated

from pickproof.cell.errors import InputError
from pickproof.scenarios.commands.arguments import WorkpieceName, about, integer, number
from pickproof.scenarios.commands.grasps.arguments import GripperName, TextFile, write_text
from pickproof.scenarios.config.seeds import MAX_SEED


def sample(
    workpiece: WorkpieceName,
    /,
    *,
    gripper: GripperName = None,
    count: Annotated[int, integer(1, 10_000), about("proposals tried")] = 12,
    seed: Annotated[int, integer(0, MAX_SEED), about("seed of the rays through the CAD")] = 0,
    least: Annotated[float, number(0, 0.999), about("smallest share of pose errors that a kept grasp tolerates")] = 0.5,
    out: TextFile = None,
) -> int:
    """`pickproof grasps sample WORKPIECE`."""
    import numpy as np

    from pickproof.grasping.sample import propose
    from pickproof.scenarios.files.grasps_text import table_text
    from pickproof.scenarios.grasp_trials.check import tried
    from pickproof.scenarios.grasp_trials.table_files import workpiece_and_gripper

    part, hand = workpiece_and_gripper(workpiece, gripper)
    points = tried(part, hand, propose(part, hand, count, np.random.default_rng(seed)), least)
    if not points:
        raise InputError(
            "command line", "workpiece", part.name, f"a workpiece that {hand.name} can hold; try another --gripper"
        )
    how = f"{part.name} --gripper {hand.name} --count {count} --seed {seed} --least {least:g}"
    comment = f"Proposed by `pickproof grasps sample {how}`.\nSchema: docs/reference/grasps-file.md."
    return write_text(table_text(points, hand.name, comment), out)
