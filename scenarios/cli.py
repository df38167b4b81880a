"""The command line. Exit codes: 0 done, 1 a gate said no, 2 bad input, 3 undecided, 130 interrupted.

What a command needs is imported when it runs: `pickproof --help` must not wait for torch.
"""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import NoReturn

from cell.errors import InputError, PickproofError
from cell.processes import FOLDERS, child_environment
from scenarios.arguments import MAX_SEED, add_scenario_arguments, integer, take_folders
from scenarios.files import free_folder

_OWN = {  # commands whose module (dashes are underscores) adds its arguments and has a `main`
    "explain": "why one attempt did what it did: estimates, grasps, verdicts",
    "index": "one page over many runs, with the trend of the rate",
    "replay": "one attempt in 3-D in the browser, or as a film",
    "export-program": "the motion of one attempt as a Fanuc TP program (.LS)",
    "grasps": "edit, check, propose, import and export the grasp points of a workpiece",
    "compare": "compare two campaigns over the same bins",
    "baseline": "write a small JSON file that a gate compares with",
    "gate": "is a system worse than its baseline? exit code 0 passed, 1 worse, 3 undecided",
    "export": "the attempts of a campaign as a Parquet file",
    "attribute": "what perception, grasp choice and motion each cost, and what to mend first",
    "onboard": "a CAD file made a workpiece: mesh checked, symmetry, collision pieces, grasps, a cell for it, a page",
    "tune": "move grasp points, weights and fields until more picks succeed, proved over unseen bins",
    "sweep": "run a scenario for every combination of values",
}

_PERCEPTION = {  # the same for modules of perception
    "generate": "settled scenes of a workpiece, stored as poses, and their export as a BOP dataset",
    "perceive": "the poses of workpieces in a depth image or point cloud of your own",
}


class _Parser(argparse.ArgumentParser):
    """Errors as one line, like every other error of the program."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"pickproof: error: {message} (see {self.prog} --help)\n")


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code."""
    words = list(sys.argv[1:] if argv is None else argv)
    try:
        rest, folders = take_folders(words)
        args = _parser(rest).parse_args(rest)
        command: Callable[[argparse.Namespace], int] = args.command
        args.words = words
        with child_environment({FOLDERS: folders} if folders else {}):
            return command(args)
    except SystemExit as leaving:  # argparse: help and errors
        return int(leaving.code or 0)
    except PickproofError as error:
        print(f"pickproof: error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"pickproof: error: {error.filename or 'file system'}: {error.strerror or error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("pickproof: interrupted", file=sys.stderr)
        return 130


def _parser(words: Sequence[str]) -> argparse.ArgumentParser:
    parser = _Parser(prog="pickproof", description="Proves a pick rate before the cell exists.")
    parser.add_argument("--version", action="version", version=_version())
    parser.add_argument(
        "--workpieces", metavar="DIR", help="any command takes it: a folder of your own workpieces, looked up first"
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    run = commands.add_parser("run", help="run episodes of a scenario and write DIR/results.sqlite and summary.json")
    add_scenario_arguments(run)
    run.add_argument("--episodes", type=integer(1, 1_000_000), default=10, metavar="N", help="bin fills (default 10)")
    run.add_argument("--seed", type=integer(0, MAX_SEED), metavar="S", help="of the first; default: the scenario's")
    run.add_argument("--out", type=Path, metavar="DIR", help="default: out/SCENARIO-SEED")
    run.add_argument("--resume", action="store_true", help="continue the campaign in --out")
    run.add_argument(
        "--ray", metavar="ADDRESS", help="run on a Ray cluster: HOST:PORT, auto, or local to start one on this machine"
    )
    run.add_argument("--no-pictures", action="store_true", help="keep no pictures of attempts")
    run.add_argument(
        "--keep", choices=("failures", "all", "none"), default="failures", help="attempts kept for `pickproof replay`"
    )
    run.add_argument("--json", action="store_true", help="print the summary as JSON; progress goes to stderr")
    run.set_defaults(command=_run, workers=None)

    report = commands.add_parser("report", help="write DIR/report.html from the results in DIR")
    report.add_argument("directory", type=Path, metavar="DIR")
    report.set_defaults(command=_report)

    train = commands.add_parser("train", help="train the network for a workpiece")
    evaluate = commands.add_parser("evaluate", help="measure perception on held-out scenes")
    benchmark = commands.add_parser(
        "benchmark",
        help="perception against its peers; motion against its bound; the error rates of a gate; speed of a campaign",
    )
    fit_score = commands.add_parser("fit-score", help="calibrate a workpiece's score on validation scenes")
    if "train" in words[:1]:
        from perception.train import add_arguments as add_train_arguments

        add_train_arguments(train)
    if "evaluate" in words[:1]:
        from perception.evaluate import add_arguments as add_evaluate_arguments

        add_evaluate_arguments(evaluate)
    if words[:2] == ["benchmark", "motion"]:
        from scenarios.benchmark_motion import add_arguments as add_motion_arguments

        add_motion_arguments(benchmark)
    elif words[:2] == ["benchmark", "campaign"]:
        from scenarios.benchmark_campaign import add_arguments as add_campaign_arguments

        add_campaign_arguments(benchmark)
    elif words[:2] == ["benchmark", "gate"]:
        from scenarios.gate_calibration import add_arguments as add_calibration_arguments

        add_calibration_arguments(benchmark)
    elif "benchmark" in words[:1]:
        from perception.benchmark import add_arguments as add_benchmark_arguments

        add_benchmark_arguments(benchmark)
    if "fit-score" in words[:1]:
        from perception.fit_score import add_arguments as add_fit_score_arguments

        add_fit_score_arguments(fit_score)
    train.set_defaults(command=_train)
    evaluate.set_defaults(command=_evaluate)
    benchmark.set_defaults(command=_benchmark)
    fit_score.set_defaults(command=_fit_score)

    for name, text in (_OWN | _PERCEPTION).items():
        own = commands.add_parser(name, help=text)
        if name in words[:1]:
            folder = "perception" if name in _PERCEPTION else "scenarios"
            module = import_module(f"{folder}.{name.replace('-', '_')}")
            module.add_arguments(own)
            own.set_defaults(command=module.main)

    listing = commands.add_parser("list", help="list scenarios and workpieces")
    listing.set_defaults(command=_list)
    return parser


def _run(args: argparse.Namespace) -> int:
    from rich.console import Console

    from scenarios.campaign import run_campaign
    from scenarios.episode import run_episode
    from scenarios.scenario import load_scenario, weights_used
    from scenarios.store import Store
    from scenarios.summary import FILE, LiveView, counted, print_summary, summarise, write_summary
    from scenarios.tape import Keep
    from scenarios.workcell import check_inputs

    scenario = load_scenario(args.scenario, args.set)
    seed = scenario.seed if args.seed is None else args.seed
    if seed + args.episodes - 1 > MAX_SEED:
        raise InputError("command line", "--seed", seed, f"at most {MAX_SEED} for the last episode")
    if args.resume and args.out is None:
        raise InputError("command line", "--resume", "no --out", "--out DIR with the results to continue")
    out = args.out or free_folder(Path("out") / f"{scenario.name}-{seed}")
    oracle = frozenset(args.oracle)
    check_inputs(scenario, oracle)
    console = Console(stderr=args.json)
    done = []
    if args.resume:
        with Store.read(out) as store:
            ended = {e.seed for e in store.episodes()}
            done = [a for a in store.attempts(large=False) if a.seed in ended]
    if not args.json:
        console.print(
            f"{scenario.name}: {counted(args.episodes, 'episode')} of {counted(scenario.count, 'workpiece')}, "
            f"results in {out}",
            soft_wrap=True,
        )
    try:
        with LiveView(console, args.episodes, scenario.count, done) as view:
            run_campaign(
                scenario.model_copy(update={"seed": seed}),
                episodes=args.episodes,
                seed=seed,
                workers=args.workers or (0 if args.ray else 1),
                ray=args.ray,
                oracle=oracle,
                out=out,
                runner=run_episode,
                keep=Keep(out, args.keep),
                weights_hash=weights_used(scenario, oracle),
                command=f"pickproof {shlex.join(args.words)}",
                resume=args.resume,
                pictures=not args.no_pictures,
                on_event=view.update,
            )
    except KeyboardInterrupt:
        with Store.read(out) as store:
            kept = len(store.attempts(large=False))
        print(
            f"pickproof: interrupted; {kept} attempts are kept in {out}, --resume --out {out} continues",
            file=sys.stderr,
        )
        return 130
    with Store.read(out) as store:
        summary = summarise(store)
    write_summary(out, summary)
    if args.json:
        print(json.dumps(summary, indent=2))
    else:
        print_summary(console, summary)
        console.print(f"wrote {out / FILE}; a page with pictures: pickproof report {out}", soft_wrap=True)
    return 0


def _report(args: argparse.Namespace) -> int:
    from scenarios.report import write_report

    print(f"wrote {write_report(args.directory)}")
    return 0


def _train(args: argparse.Namespace) -> int:
    from perception.train import main_train

    return main_train(args)


def _evaluate(args: argparse.Namespace) -> int:
    from perception.evaluate import main_evaluate

    return main_evaluate(args)


def _benchmark(args: argparse.Namespace) -> int:
    if args.subject == "motion":
        from scenarios.benchmark_motion import main_benchmark_motion

        return main_benchmark_motion(args)
    if args.subject == "campaign":
        from scenarios.benchmark_campaign import main as main_campaign

        return main_campaign(args)
    if args.subject == "gate":
        from scenarios.gate_calibration import main as main_calibration

        return main_calibration(args)
    from perception.benchmark import main_benchmark

    return main_benchmark(args)


def _fit_score(args: argparse.Namespace) -> int:
    from perception.fit_score import main_fit_score

    return main_fit_score(args)


def _list(args: argparse.Namespace) -> int:
    from cell.workpiece import list_workpieces
    from scenarios.scenario import list_scenarios, load_scenario

    print("scenarios")
    for name in list_scenarios():
        scenario = load_scenario(name)
        print(f"  {name:20} {scenario.count} x {scenario.workpiece}, {scenario.robot} with {scenario.gripper}")
    print("workpieces")
    for name in list_workpieces():
        print(f"  {name}")
    return 0


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return f"pickproof {version('pickproof')}"
    except PackageNotFoundError:
        return "pickproof (not installed)"


if __name__ == "__main__":
    sys.exit(main())
