"""Every command: its group in the help, the function that runs it, and what it does.

cyclopts was taken over typer (measured with 20 commands, processor time of a quiet start of Python taken off:
`--help` 0.17 s against 0.23 s, help of a command 0.2 s against 0.5 s), because it imports a command from its path only
when it is called, and takes the options of a command as one frozen dataclass.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

from cyclopts import App, Group, Parameter

from pickproof.cell.child_process import FOLDERS, child_environment
from pickproof.cell.errors import PickproofError
from pickproof.scenarios.commands.arguments import search_folders
from pickproof.scenarios.commands.refusal import no_command

_HERE = "pickproof.scenarios.commands"
GROUPS = ("pick", "decide", "workpiece", "perception", "benchmark")


@dataclass(frozen=True)
class Command:
    """A command.

    Attributes:
        name: as it is typed, after that of a command above it.
        group: one of GROUPS; for others, that of --help.
        path: MODULE:FUNCTION, in this folder.
        help: what it does.
    """

    name: str
    group: str
    path: str
    help: str


COMMANDS = (
    Command("run", "pick", "run:run", "run episodes of a scenario and write DIR/results.sqlite and summary.json"),
    Command("report", "pick", "report:report", "write DIR/report.html from the results in DIR"),
    Command("explain", "pick", "explain:explain", "the decisions of one attempt: estimates, grasps, verdicts"),
    Command("replay", "pick", "replay:replay", "one attempt in 3-D in the browser, or as a film"),
    Command("index", "pick", "index:index", "one page over many runs, with the trend of the rate"),
    Command("export", "pick", "export:export", "the attempts of a campaign as a Parquet file"),
    Command(
        "export-program",
        "pick",
        "export_program:export_program",
        "the motion of one attempt as a Fanuc TP program (.LS)",
    ),
    Command("compare", "decide", "compare:compare", "compare two campaigns over the same bins"),
    Command("baseline", "decide", "baseline:baseline", "write a small JSON file that a gate compares with"),
    Command(
        "gate",
        "decide",
        "gate:gate",
        "test whether a system is worse than its baseline; exit code 0 passed, 1 worse, 3 undecided",
    ),
    Command(
        "attribute",
        "decide",
        "attribute:attribute",
        "loss of pick success by perception, grasp choice and motion, and what to improve first",
    ),
    Command(
        "sweep",
        "decide",
        "sweep:sweep",
        "run a scenario for every combination of the values that --set names",
    ),
    Command(
        "onboard",
        "workpiece",
        "onboard:onboard",
        "a workpiece from a CAD file: mesh check, symmetry, collision pieces, grasps, a cell for it, a page",
    ),
    Command(
        "tune",
        "workpiece",
        "tune:tune",
        "search grasp points, weights and fields for a higher pick success, and check them in unseen bins",
    ),
    Command("train", "perception", "train:train", "train the network for a workpiece"),
    Command("evaluate", "perception", "evaluate:evaluate", "measure perception on held-out scenes"),
    Command(
        "perceive",
        "perception",
        "perceive:perceive",
        "poses of workpieces in your own depth image or point cloud",
    ),
    Command(
        "generate",
        "perception",
        "generate:generate",
        "settled scenes of a workpiece, stored as poses, and their export as a BOP dataset",
    ),
    Command(
        "fit-score",
        "perception",
        "fit_score:fit_score",
        "calibrate a workpiece's score on validation scenes",
    ),
    Command("list", "more", "listing:listing", "list scenarios and workpieces"),
    Command("completion", "more", "completion:completion", "print the completion script of a shell"),
)
GRASPS = (
    Command("edit", "grasps", "grasps_edit:edit", "move, check, try and save grasps in the browser"),
    Command("check", "grasps", "grasps_check:check", "try each grasp on a single workpiece in every resting pose"),
    Command("sample", "grasps", "grasps_sample:sample", "propose grasp points from the CAD, tried in the physics"),
    Command(
        "robustness",
        "grasps",
        "grasps_robustness:robustness",
        "pose errors that each grasp tolerates, compared with those of perception",
    ),
    Command("import", "grasps", "grasps_import:import_", "an isaac_grasp file (format version 1.0) as grasps.yaml"),
    Command("export", "grasps", "grasps_export:export", "grasps.yaml as an isaac_grasp file (format version 1.0)"),
)
BENCHMARKS = (
    Command(
        "perception",
        "benchmark",
        "benchmark_perception:benchmark_perception",
        "PS6D, its peers and its ablations on held-out heaps",
    ),
    Command(
        "motion",
        "benchmark",
        "benchmark_motion:benchmark_motion",
        "cycle times beside their lower bound",
    ),
    Command(
        "campaign",
        "benchmark",
        "benchmark_campaign:benchmark_campaign",
        "attempts per hour and core, and time by stage",
    ),
    Command(
        "gate",
        "benchmark",
        "benchmark_gate:benchmark_gate",
        "error rates of the gate and coverage of the intervals",
    ),
)
MAKES_FOLDER = "onboard"
"""The function of the command that creates the first folder of --workpieces."""


class NoCommandError(PickproofError):
    """The command line ends before a command is named."""


def build_app() -> App:
    """The command line; no command is imported."""
    groups = {name: Group(name, sort_key=i) for i, name in enumerate(GROUPS)}
    rest = Group("more", sort_key=len(GROUPS))
    app = App(
        name="pickproof",
        help="Measures the pick rate of a bin picking cell in simulation, from depth image to counted pick.",
        help_format="plaintext",
        version=_version,
        group_commands=rest,
        default_parameter=Parameter(negative="", show_default=_shown, allow_repeating=True),
        result_action="return_value",
    )
    _add(app, COMMANDS, groups)
    grasps = App(
        name="grasps",
        help="edit, check, propose, import and export the grasp points of a workpiece",
        group=groups["workpiece"],
        sort_key=1.5,
        help_format="plaintext",
    )
    benchmark = App(
        name="benchmark",
        help="perception against other methods; motion against its bound; error rates of a gate; speed of a campaign",
        group=groups["benchmark"],
        help_format="plaintext",
    )
    _add(grasps, GRASPS, {})
    _add(benchmark, BENCHMARKS, {})
    app.command(grasps)
    app.command(benchmark)
    app.meta.end_of_options_delimiter = ""  # `--` is a word for the command
    app.meta.default(_launcher(app))
    return app


def _add(app: App, commands: tuple[Command, ...], groups: dict[str, Group]) -> None:
    for i, command in enumerate(commands):
        app.command(
            f"{_HERE}.{command.path}",
            name=command.name,
            help=command.help,
            group=groups.get(command.group),
            sort_key=i,
        )


Words = Annotated[str, Parameter(show=False, allow_leading_hyphen=True)]
Folders = Annotated[
    tuple[str, ...],
    Parameter(help="a folder of your own workpieces, searched first; may be repeated", negative=""),
]


def _launcher(app: App) -> Callable[..., Any]:
    """Takes --workpieces at any position and passes the other words to the command."""

    def launch(*words: Words, workpieces: Folders = ()) -> Any:
        command, bound, _ = app.parse_args(words, exit_on_error=False, print_error=False)
        if getattr(command, "__name__", "") == "help_print" and not {"--help", "-h"} & set(words):
            raise NoCommandError(no_command(app[words[0]] if words else app))
        folders = search_folders(workpieces, getattr(command, "__name__", "") == MAKES_FOLDER)
        with child_environment({FOLDERS: folders} if folders else {}):
            return command(*bound.args, **bound.kwargs)

    return launch


def _shown(default: object) -> object:
    """The default shown in the help; nothing for an option that is off or empty."""
    if default is None or default is False or default in ((), ""):
        return None
    return " ".join(map(str, default)) if isinstance(default, tuple) else str(default)


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return f"pickproof {version('pickproof')}"
    except PackageNotFoundError:
        return "pickproof (not installed)"
