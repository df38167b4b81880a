"""The command line.

Exit codes: 0 done, 1 a gate said no, 2 bad input, 3 undecided, 70 a fault of the program, 130 interrupted. Nothing but
a gate returns 1, which is what Python itself returns for a traceback.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import traceback
from collections.abc import Callable, Sequence
from importlib import import_module

from pickproof.cell.child_process import FOLDERS, child_environment
from pickproof.cell.errors import PickproofError
from pickproof.scenarios.commands.arguments import search_folders
from pickproof.scenarios.commands.parsing import Parser
from pickproof.scenarios.commands.streams import lasting_streams, to_nowhere

INTERNAL = 70
"""EX_SOFTWARE of sysexits.h: an exception that nobody expected."""

Command = tuple[str, str, str]
"""Module with `add_arguments`, its function that runs the command, and what the command does."""
_COMMANDS: dict[str, Command] = {
    "run": (
        "pickproof.scenarios.commands.run",
        "main",
        "run episodes of a scenario and write DIR/results.sqlite and summary.json",
    ),
    "report": ("pickproof.scenarios.commands.report", "main", "write DIR/report.html from the results in DIR"),
    "explain": (
        "pickproof.scenarios.commands.explain",
        "main",
        "why one attempt did what it did: estimates, grasps, verdicts",
    ),
    "index": ("pickproof.scenarios.commands.index", "main", "one page over many runs, with the trend of the rate"),
    "replay": ("pickproof.scenarios.commands.replay", "main", "one attempt in 3-D in the browser, or as a film"),
    "export-program": (
        "pickproof.scenarios.commands.export_program",
        "main",
        "the motion of one attempt as a Fanuc TP program (.LS)",
    ),
    "export": ("pickproof.scenarios.commands.export", "main", "the attempts of a campaign as a Parquet file"),
    "compare": ("pickproof.scenarios.commands.compare", "main", "compare two campaigns over the same bins"),
    "baseline": ("pickproof.scenarios.commands.baseline", "main", "write a small JSON file that a gate compares with"),
    "gate": (
        "pickproof.scenarios.commands.gate",
        "main",
        "is a system worse than its baseline? exit code 0 passed, 1 worse, 3 undecided",
    ),
    "attribute": (
        "pickproof.scenarios.commands.attribute",
        "main",
        "what perception, grasp choice and motion each cost, and what to mend first",
    ),
    "sweep": ("pickproof.scenarios.commands.sweep", "main", "run a scenario for every combination of values"),
    "tune": (
        "pickproof.scenarios.commands.tune",
        "main",
        "move grasp points, weights and fields until more picks succeed, proved over unseen bins",
    ),
    "onboard": (
        "pickproof.scenarios.commands.onboard",
        "main",
        "a CAD file made a workpiece: mesh checked, symmetry, collision pieces, grasps, a cell for it, a page",
    ),
    "grasps": (
        "pickproof.scenarios.commands.grasps",
        "main",
        "edit, check, propose, import and export the grasp points of a workpiece",
    ),
    "generate": (
        "pickproof.perception.data.generate",
        "main",
        "settled scenes of a workpiece, stored as poses, and their export as a BOP dataset",
    ),
    "train": ("pickproof.perception.training.train", "main_train", "train the network for a workpiece"),
    "evaluate": ("pickproof.perception.evaluation.evaluate", "main_evaluate", "measure perception on held-out scenes"),
    "fit-score": (
        "pickproof.perception.evaluation.fit_score",
        "main_fit_score",
        "calibrate a workpiece's score on validation scenes",
    ),
    "perceive": (
        "pickproof.perception.own_images.perceive",
        "main",
        "the poses of workpieces in a depth image or point cloud of your own",
    ),
}
_BENCHMARKS: dict[str, Command] = {
    "perception": (
        "pickproof.perception.benchmark.run",
        "main_benchmark",
        "PS6D, its peers and its ablations on held-out heaps",
    ),
    "motion": (
        "pickproof.scenarios.commands.benchmark_motion",
        "main_benchmark_motion",
        "cycle times beside their lower bound",
    ),
    "campaign": (
        "pickproof.scenarios.commands.benchmark_campaign",
        "main",
        "attempts an hour of one core, and where their time goes",
    ),
    "gate": (
        "pickproof.scenarios.commands.benchmark_gate",
        "main",
        "the gate's error rates and the coverage of the intervals",
    ),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code, which a reader of the output that goes away does not change."""
    words = list(sys.argv[1:] if argv is None else argv)
    with lasting_streams():
        code = _guarded(words)
        try:
            sys.stdout.flush()
        except OSError as error:
            to_nowhere(sys.stdout)
            print(f"pickproof: error: standard output: {error.strerror}", file=sys.stderr)
            return code or 2
        return code


def _guarded(words: list[str]) -> int:
    """The exit code of a command, whatever it raises."""
    try:
        parser = _parser()
        args = parser.parse_args(words)
        folders = search_folders(parser.folders, getattr(args, "makes_folder", False))
        command: Callable[[argparse.Namespace], int] = args.command
        args.words = words
        with child_environment({FOLDERS: folders} if folders else {}):
            return command(args)
    except SystemExit as leaving:  # argparse: help and errors
        return leaving.code if isinstance(leaving.code, int) else 0 if leaving.code is None else INTERNAL
    except PickproofError as error:
        print(f"pickproof: error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"pickproof: error: {error.filename or 'file system'}: {error.strerror or error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("pickproof: interrupted", file=sys.stderr)
        return 130
    except Exception as error:  # noqa: BLE001  whatever it is, Python's exit code for it is a gate's "worse"
        what = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        print(f"pickproof: internal error: {what}{_noted(error)}", file=sys.stderr)
        return INTERNAL


def _noted(error: Exception) -> str:
    """Where the traceback was written, in words; nothing where no file can be written."""
    try:
        handle, file = tempfile.mkstemp(prefix="pickproof-", suffix=".txt")
        with os.fdopen(handle, "w", encoding="utf-8", errors="backslashreplace") as out:
            traceback.print_exception(error, file=out)
    except OSError:
        return ""
    return f"; the traceback is in {file}"


def _parser() -> Parser:
    parser = Parser(prog="pickproof", description="Proves a pick rate before the cell exists.")
    parser.add_argument("--version", action=_Version)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for name, (module, main, text) in _COMMANDS.items():
        commands.add_parser(name, help=text, fill=_filled_by(module, main))
    measured = "perception against its peers; motion against its bound; the error rates of a gate; speed of a campaign"
    benchmark = commands.add_parser("benchmark", help=measured)
    subjects = benchmark.add_subparsers(required=True, metavar="SUBJECT")
    for name, (module, main, text) in _BENCHMARKS.items():
        subjects.add_parser(name, help=text, fill=_filled_by(module, main))
    commands.add_parser("list", help="list scenarios and workpieces").set_defaults(command=_list)
    return parser


def _filled_by(module: str, main: str) -> Callable[[Parser], None]:
    """Adds the arguments of a command from its module."""

    def fill(parser: Parser) -> None:
        found = import_module(module)
        found.add_arguments(parser)
        parser.set_defaults(command=getattr(found, main))

    return fill


def _list(args: argparse.Namespace) -> int:
    from pickproof.cell.workpiece.workpiece import list_workpieces
    from pickproof.scenarios.config.scenario import list_scenarios, load_scenario

    print("scenarios")
    for name in list_scenarios():
        scenario = load_scenario(name)
        print(f"  {name:20} {scenario.count} x {scenario.workpiece}, {scenario.robot} with {scenario.gripper}")
    print("workpieces")
    for name in list_workpieces():
        print(f"  {name}")
    return 0


class _Version(argparse.Action):
    """Prints the version, which is looked up only then."""

    def __init__(self, option_strings: Sequence[str], dest: str, **_: object) -> None:
        super().__init__(option_strings, argparse.SUPPRESS, nargs=0, help="show the version and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import PackageNotFoundError, version

        try:
            found = version("pickproof")
        except PackageNotFoundError:
            found = "(not installed)"
        parser.exit(0, f"pickproof {found}\n")


if __name__ == "__main__":
    sys.exit(main())
