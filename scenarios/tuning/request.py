"""The request of a tuning run, and the plan built from it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pickproof.cell.errors import InputError
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.grasping.grasp_points import load_grasps, read_table
from pickproof.scenarios.config.scenario import Scenario, load_scenario, scenario_path
from pickproof.scenarios.config.seeds import MAX_SEED
from pickproof.scenarios.files.atomic import free_folder
from pickproof.scenarios.grasp_trials.robustness import named, read_errors
from pickproof.scenarios.tuning.grasp_space import Reach
from pickproof.scenarios.tuning.plan import HOLDOUT, Plan
from pickproof.scenarios.tuning.proposal import check_editable
from pickproof.scenarios.tuning.scenario_fields import parse_field


@dataclass(frozen=True, kw_only=True)
class TuneRequest:
    """A tuning run, as a user asks for it.

    Attributes:
        scenario: name or file; changes: FIELD=LOW:HIGH is searched, FIELD=VALUE is fixed.
        oracle: stages that ground truth replaces.
        grasps: `all`, `none`, or names with commas.
        shift: of a grasp's centre along each axis, in [mm]; turn: about each axis of the tool, in [deg].
        errors: evaluation.json with perception's errors.
        generations: of each grasp; rounds: of whole cells.
        episodes: of a candidate; block: episodes at a time; holdout: unseen episodes.
        budget_s: stages end early for it; None for no limit.
        seed: None for the scenario's; workers: processes; ray: address of a cluster.
        out: None for a folder that is free.
        command: the command line, for the record.
    """

    scenario: str
    changes: tuple[str, ...] = ()
    oracle: tuple[str, ...] = ()
    grasps: str = "all"
    shift: float = 8.0
    turn: float = 15.0
    errors: Path | None = None
    generations: int = 8
    rounds: int = 4
    episodes: int = 8
    block: int = 2
    holdout: int = 20
    budget_s: float | None = None
    seed: int | None = None
    workers: int = 1
    ray: str | None = None
    out: Path | None = None
    command: str = ""


def plan_of(asked: TuneRequest) -> Plan:
    """The plan of a request.

    Raises:
        InputError: something in it is not valid.
    """
    scenario = fixed_scenario(asked)
    if asked.seed is not None:
        scenario = scenario.model_copy(update={"seed": asked.seed})
    last = scenario.seed + HOLDOUT + asked.holdout
    if last > MAX_SEED:
        raise InputError("command line", "--seed", scenario.seed, f"at most {MAX_SEED - HOLDOUT - asked.holdout}")
    if asked.block > asked.episodes:
        raise InputError("command line", "--block", asked.block, f"at most --episodes, {asked.episodes}")
    fields = [f for text in asked.changes if (f := parse_field(text, scenario)) is not None]
    if twice := sorted({f.name for f in fields if sum(g.name == f.name for g in fields) > 1}):
        raise InputError("command line", "--set", twice[0], "one range for each field")
    workpiece, gripper = load_workpiece(scenario.workpiece), load_gripper(scenario.gripper)
    table = table_of(scenario)
    usable = {p.name for p in load_grasps(workpiece, gripper, table).points if p.gripper == gripper.name and p.enabled}
    read = read_table(table)
    points = read.grasps
    for file in (table, scenario_path(asked.scenario)):
        check_editable(file)
    names = [] if asked.grasps == "none" else named([p for p in points if p.name in usable], asked.grasps, table)
    if not names and not fields:
        raise InputError("command line", "--grasps", asked.grasps, "grasp points, or --set FIELD=LOW:HIGH to search")
    return Plan(
        scenario=scenario,
        table=table,
        gripper=read.gripper,
        points=tuple(points),
        names=tuple(p.name for p in names),
        fields=tuple(fields),
        oracle=frozenset(asked.oracle),
        out=asked.out or free_folder(Path("out") / f"tune-{scenario.name}"),
        reach=Reach(asked.shift / 1000, asked.turn),
        generations=asked.generations,
        rounds=asked.rounds,
        episodes=asked.episodes,
        block=asked.block,
        holdout=asked.holdout,
        p95=read_errors(asked.errors) if asked.errors else None,
        budget_s=asked.budget_s,
        workers=asked.workers,
        ray=asked.ray,
        command=asked.command,
    )


def fixed_scenario(asked: TuneRequest) -> Scenario:
    """The scenario with the fields that FIELD=VALUE fixes."""
    plain = [text for text in asked.changes if ":" not in text.partition("=")[2] or text.partition("=")[2][:1] in "{["]
    return load_scenario(asked.scenario, plain)


def table_of(scenario: Scenario) -> Path:
    """The grasp table that a scenario uses."""
    return Path(scenario.grasps) if scenario.grasps else load_workpiece(scenario.workpiece).folder / "grasps.yaml"
