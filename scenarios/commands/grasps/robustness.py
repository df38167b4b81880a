"""`pickproof grasps robustness WORKPIECE`: the errors of the pose that each grasp tolerates."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pickproof.scenarios.commands.arguments import FOLDER_TO_WRITE, SOME_PATH, Flat, Workers, WorkpieceName, about


@dataclass(frozen=True, kw_only=True)
class RobustnessOptions:
    """Options of `pickproof grasps robustness`."""

    gripper: Annotated[str | None, about("default: that of the table")] = None
    grasps: Annotated[str, about("all, or names with commas")] = "all"
    table: Annotated[Path | None, SOME_PATH, about("grasp points; default: the workpiece's grasps.yaml")] = None
    errors: Annotated[
        Path | None, SOME_PATH, about("evaluation.json; default: that in out/evaluate/WORKPIECE, where it is")
    ] = None
    workers: Workers = 1
    out: Annotated[Path | None, FOLDER_TO_WRITE, about("default: out/robustness-WORKPIECE")] = None


def robustness(
    workpiece: WorkpieceName,
    /,
    *,
    options: Annotated[RobustnessOptions, Flat] = RobustnessOptions(),
) -> int:
    """`pickproof grasps robustness WORKPIECE`."""
    from rich.console import Console
    from rich.progress import track

    from pickproof.grasping.grasp_points import load_grasps
    from pickproof.scenarios.campaign.parallel_map import mapping
    from pickproof.scenarios.files.atomic import write_json
    from pickproof.scenarios.grasp_trials.robustness import Task, document, named, read_errors, try_robustness, verdict
    from pickproof.scenarios.grasp_trials.robustness_report import plot_robustness, robustness_table
    from pickproof.scenarios.grasp_trials.table_files import workpiece_and_gripper

    part, hand = workpiece_and_gripper(workpiece, options.gripper, options.table)
    table = options.table or part.folder / "grasps.yaml"
    enabled = [p for p in load_grasps(part, hand, table).points if p.gripper == hand.name]
    points = named(enabled, options.grasps, table)
    measured = Path("out") / "evaluate" / part.name / "evaluation.json"
    source = options.errors or (measured if measured.is_file() else None)
    errors = read_errors(source) if source else None
    console, tasks = Console(), [Task(part.name, hand.name, p) for p in points]
    with mapping(options.workers) as run:
        grasps = list(track(run(try_robustness, tasks), "grasps", len(tasks), console=console))
    out = options.out or Path("out") / f"robustness-{part.name}"
    write_json(out / "robustness.json", document(grasps, errors))
    plot_robustness(grasps, errors, f"{part.name} with {hand.name}", out / "robustness.png")
    console.print(robustness_table(grasps, errors))
    for grasp in grasps:
        console.print(f"{grasp.grasp}: {verdict(grasp, errors)}", soft_wrap=True, highlight=False)
    if errors is None:
        console.print(f"errors of perception are unknown; run: pickproof evaluate {part.name}", soft_wrap=True)
    console.print(f"wrote robustness.json and robustness.png to {out}", soft_wrap=True)
    return 0
