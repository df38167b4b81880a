"""`pickproof tune`: grasp points, weights of the rank and fields of the scenario, moved until more picks succeed."""

from __future__ import annotations

import argparse
import hashlib
import re
import shlex
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from pickproof.cell.errors import InputError
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.grasping.grasp_points import load_grasps, read_table
from pickproof.scenarios.campaign.parallel_map import mapping
from pickproof.scenarios.commands.arguments import (
    MAX_SEED,
    add_scenario_arguments,
    folder_to_write,
    integer,
    number,
    some_path,
)
from pickproof.scenarios.comparison.compare import print_comparison
from pickproof.scenarios.config.scenario import Scenario, load_scenario, scenario_json, scenario_path
from pickproof.scenarios.files.atomic import free_folder, write_json, write_whole
from pickproof.scenarios.grasp_trials.robustness import named, read_errors
from pickproof.scenarios.tuning.cell_stage import CELL
from pickproof.scenarios.tuning.grasp_space import Reach
from pickproof.scenarios.tuning.optimizer import JOURNAL, open_journal
from pickproof.scenarios.tuning.plan import HOLDOUT, Plan, Runners
from pickproof.scenarios.tuning.proposal import (
    SCENARIO,
    TABLE,
    accept,
    changed_scenario,
    changed_table,
    check_editable,
    read_proposal,
)
from pickproof.scenarios.tuning.report import REPORT, document, print_grasps, write_tune_report
from pickproof.scenarios.tuning.run import run_plan
from pickproof.scenarios.tuning.scenario_fields import parse_field

STATE, RESULT = "plan.json", "tune.json"
SECONDS = {"s": 1.0, "m": 60.0, "h": 3600.0}


def duration(text: str) -> float:
    """`90s`, `30m` or `1.5h` in [s]."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)([smh])", text)
    if match is None or float(match[1]) <= 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not valid; expected a time as 90s, 30m or 2h")
    return float(match[1]) * SECONDS[match[2]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `pickproof tune`."""
    add_scenario_arguments(parser)
    parser.epilog = "--set FIELD=LOW:HIGH searches a number of the scenario, --set FIELD=VALUE fixes it for old and new"
    parser.add_argument("--grasps", default="all", metavar="NAMES", help="all, none, or names with commas")
    parser.add_argument(
        "--shift", type=number(0, 1000), default=8.0, metavar="MM", help="of a centre, along each axis (8)"
    )
    parser.add_argument(
        "--turn", type=number(0, 1000), default=15.0, metavar="DEG", help="about each axis of the tool (15)"
    )
    parser.add_argument("--errors", type=some_path, metavar="FILE", help="evaluation.json with perception's errors")
    parser.add_argument("--generations", type=integer(1, 1000), default=8, metavar="N", help="of each grasp (8)")
    parser.add_argument("--rounds", type=integer(1, 1000), default=4, metavar="N", help="of whole cells (4)")
    parser.add_argument("--episodes", type=integer(1, 100_000), default=8, metavar="N", help="of a candidate (8)")
    parser.add_argument("--block", type=integer(1, 10_000), default=2, metavar="N", help="episodes at a time (2)")
    parser.add_argument("--holdout", type=integer(2, 100_000), default=20, metavar="N", help="unseen episodes (20)")
    parser.add_argument("--budget", type=duration, metavar="TIME", help="as 30m or 2h; stages end early for it")
    parser.add_argument("--seed", type=integer(0, MAX_SEED), metavar="S", help="default: the scenario's")
    parser.add_argument("--ray", metavar="ADDRESS", help="run campaigns on a Ray cluster, as `pickproof run` does")
    parser.add_argument("--out", type=folder_to_write, metavar="DIR", help="default: out/tune-SCENARIO")
    parser.add_argument("--resume", action="store_true", help="go on with the search in --out")
    parser.add_argument("--accept", action="store_true", help="write what --out proposes over table and scenario")
    parser.set_defaults(workers=1)


def main(args: argparse.Namespace) -> int:
    """`pickproof tune SCENARIO`."""
    from pickproof.scenarios.campaign.episode import run_episode
    from pickproof.scenarios.picking.workcell import check_inputs

    if (args.resume or args.accept) and args.out is None:
        option = "--accept" if args.accept else "--resume"
        raise InputError("command line", option, "no --out", "--out DIR with the search")
    if args.accept:
        return _accept(args)
    plan = plan_of(args)
    source = scenario_path(args.scenario)
    texts = {file: file.read_text(encoding="utf-8") for file in (plan.table, source)}
    check_inputs(plan.scenario, plan.oracle)
    _claim(plan, resume=args.resume)
    console = Console()
    console.print(
        f"{plan.scenario.name}: {len(plan.names)} grasps and {len(plan.fields)} fields, results in {plan.out}",
        soft_wrap=True,
    )
    columns = [TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()]
    try:
        with Progress(*columns, console=console) as bar, mapping(plan.workers) as run:
            stages: dict[str, Any] = {}

            def tell(stage: str, done: int, total: int) -> None:
                if stage not in stages:
                    stages[stage] = bar.add_task(stage, total=None)
                bar.update(stages[stage], completed=done, total=total or None)

            result = run_plan(plan, open_journal(plan.out), Runners(run, run_episode, tell=tell))
    except KeyboardInterrupt:
        print(
            f"pickproof: interrupted; what was found is kept, --resume --out {plan.out} with the same words continues",
            file=sys.stderr,
        )
        return 130
    write_whole(plan.out / TABLE, changed_table(plan.table, plan.points, result.points, texts[plan.table]))
    write_whole(plan.out / SCENARIO, changed_scenario(source, result.fields, TABLE, texts[source]))
    write_json(plan.out / RESULT, document(result) | {"scenario_file": _digest(texts[source])})
    page = write_tune_report(plan, result, plan.out / REPORT)
    print_grasps(console, result)
    if result.comparison is None and not result.history[CELL]:
        console.print("the budget ended before whole cells were tried; --resume with the same words goes on")
    elif result.comparison is None:
        console.print("nothing better than what there was has been found")
    else:
        print_comparison(console, result.comparison, plan.out / "old", plan.out / "new")
    console.print(
        f"wrote {page}, {TABLE} and {SCENARIO} beside it; --accept --out {plan.out} takes them over", soft_wrap=True
    )
    return 0


def plan_of(args: argparse.Namespace) -> Plan:
    """What the command line asks for.

    Raises:
        InputError: something in it is not valid.
    """
    scenario = _fixed(args)
    if args.seed is not None:
        scenario = scenario.model_copy(update={"seed": args.seed})
    last = scenario.seed + HOLDOUT + args.holdout
    if last > MAX_SEED:
        raise InputError("command line", "--seed", scenario.seed, f"at most {MAX_SEED - HOLDOUT - args.holdout}")
    if args.block > args.episodes:
        raise InputError("command line", "--block", args.block, f"at most --episodes, {args.episodes}")
    fields = [f for text in args.set if (f := parse_field(text, scenario)) is not None]
    if twice := sorted({f.name for f in fields if sum(g.name == f.name for g in fields) > 1}):
        raise InputError("command line", "--set", twice[0], "one range for each field")
    workpiece, gripper = load_workpiece(scenario.workpiece), load_gripper(scenario.gripper)
    table = _table_of(scenario)
    usable = {p.name for p in load_grasps(workpiece, gripper, table).points if p.gripper == gripper.name and p.enabled}
    read = read_table(table)
    points = read.grasps
    for file in (table, scenario_path(args.scenario)):
        check_editable(file)
    names = [] if args.grasps == "none" else named([p for p in points if p.name in usable], args.grasps, table)
    if not names and not fields:
        raise InputError("command line", "--grasps", args.grasps, "grasp points, or --set FIELD=LOW:HIGH to search")
    return Plan(
        scenario=scenario,
        table=table,
        gripper=read.gripper,
        points=tuple(points),
        names=tuple(p.name for p in names),
        fields=tuple(fields),
        oracle=frozenset(args.oracle),
        out=args.out or free_folder(Path("out") / f"tune-{scenario.name}"),
        reach=Reach(args.shift / 1000, args.turn),
        generations=args.generations,
        rounds=args.rounds,
        episodes=args.episodes,
        block=args.block,
        holdout=args.holdout,
        p95=read_errors(args.errors) if args.errors else None,
        budget_s=args.budget,
        workers=args.workers,
        ray=args.ray,
        command=f"pickproof {shlex.join(args.words)}",
    )


def _fixed(args: argparse.Namespace) -> Scenario:
    """The scenario with the fields that `--set FIELD=VALUE` fixes."""
    plain = [text for text in args.set if ":" not in text.partition("=")[2] or text.partition("=")[2][:1] in "{["]
    return load_scenario(args.scenario, plain)


def _table_of(scenario: Scenario) -> Path:
    return Path(scenario.grasps) if scenario.grasps else load_workpiece(scenario.workpiece).folder / "grasps.yaml"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _claim(plan: Plan, resume: bool) -> None:
    """Note in DIR what is searched, or hold it against what was.

    Raises:
        InputError: there is another search, or one that --resume does not ask for.
    """
    now = _identity(plan)
    there = plan.out / STATE
    if not resume:
        if (plan.out / JOURNAL).exists():
            raise InputError("command line", "--out", str(plan.out), "a folder without a search, or --resume")
        write_json(there, now)
        return
    before = read_proposal(there)
    different = sorted(k for k in now.keys() | before.keys() if now.get(k) != before.get(k))
    if different:
        raise InputError("command line", f"--resume {plan.out}", f"changed: {', '.join(different)}", "the same search")


def _identity(plan: Plan) -> dict[str, Any]:
    """What a search must have in common with one that it continues; more generations or bins are no other search."""
    return {
        "scenario": hashlib.sha256(scenario_json(plan.scenario).encode()).hexdigest(),
        "table": hashlib.sha256(plan.table.read_bytes()).hexdigest(),
        "grasps": list(plan.names),
        "fields": [asdict(f) for f in plan.fields],
        "oracle": sorted(plan.oracle),
        "reach": asdict(plan.reach),
        "errors": plan.p95,
        "block": plan.block,
        "episodes": plan.episodes,
    }


def _accept(args: argparse.Namespace) -> int:
    table, source = _table_of(_fixed(args)), scenario_path(args.scenario)
    result, before = read_proposal(args.out / RESULT), read_proposal(args.out / STATE)
    if hashlib.sha256(table.read_bytes()).hexdigest() != before["table"]:
        raise InputError(table, "", "changed since the search, or another table", "the one that the search began with")
    if result["fields"] and _digest(source.read_text(encoding="utf-8")) != result.get("scenario_file"):
        raise InputError(source, "", "changed since the search, or another scenario", "the one that was searched")
    comparison = result["comparison"]
    if comparison is not None and comparison["verdict"] != "better":
        print(f"over unseen bins: {comparison['verdict']}")
    written = accept(args.out, table, source, result["fields"])
    print("wrote " + ", ".join(str(p) for p in written) if written else "nothing to change")
    return 0
