"""Every command: its group in the help, the function that runs it, and what it does.

cyclopts was taken over typer because it imports a command from its path only when it is called, and takes the options
of a command as one frozen dataclass. Measured with 20 commands, processor time on a busy machine, 2026-12-01: `--help`
0.22 to 0.32 s against 0.27 s, help of one command 0.37 s against 0.49 s.
"""

from __future__ import annotations

import builtins
import keyword
from collections.abc import Callable
from typing import Annotated, Any

from cyclopts import App, Group, Parameter

from pickproof.cell.child_process import FOLDERS, child_environment
from pickproof.cell.errors import PickproofError
from pickproof.scenarios.commands.arguments import search_folders
from pickproof.scenarios.commands.refusal import no_command

_HERE = "pickproof.scenarios.commands"
GROUPS = ("pick", "decide", "workpiece", "perception", "benchmark")
"""Titles in the help, in their order; the other commands stand below --help."""
BELOW = {
    "grasps": "edit, check, propose, import and export the grasp points of a workpiece",
    "benchmark": "perception against other methods, motion against its bound, error rates of a gate, speed",
}
"""Groups whose commands are typed after the name of the group."""
COMMANDS: dict[str, dict[str, str]] = {
    "pick": {
        "run": "run episodes of a scenario and write DIR/results.sqlite and summary.json",
        "report": "write DIR/report.html from the results in DIR",
        "explain": "the decisions of one attempt: estimates, grasps, verdicts",
        "replay": "one attempt in 3-D in the browser, or as a film",
        "index": "one page over many runs, with the trend of the rate",
        "export": "the attempts of a campaign as a Parquet file",
        "export-program": "the motion of one attempt as a Fanuc TP program (.LS)",
    },
    "decide": {
        "compare": "compare two campaigns over the same bins",
        "baseline": "write a small JSON file that a gate compares with",
        "gate": "test whether a system is worse than its baseline; exit code 0 passed, 1 worse, 3 undecided",
        "attribute": "loss of pick success by perception, grasp choice and motion, and what to improve first",
        "sweep": "run a scenario for every combination of the values that --set names",
    },
    "workpiece": {
        "onboard": "a workpiece from a CAD file: mesh check, symmetry, collision pieces, grasps, a cell for it, a page",
        "tune": "search grasp points, weights and fields for a higher pick success, and check them in unseen bins",
    },
    "grasps": {
        "edit": "move, check, try and save grasps in the browser",
        "check": "try each grasp on a single workpiece in every resting pose",
        "sample": "propose grasp points from the CAD, tried in the physics",
        "robustness": "pose errors that each grasp tolerates, compared with those of perception",
        "import": "an isaac_grasp file (format version 1.0) as grasps.yaml",
        "export": "grasps.yaml as an isaac_grasp file (format version 1.0)",
    },
    "perception": {
        "train": "train the network for a workpiece",
        "evaluate": "measure perception on held-out scenes",
        "perceive": "poses of workpieces in your own depth image or point cloud",
        "generate": "settled scenes of a workpiece, stored as poses, and their export as a BOP dataset",
        "fit-score": "calibrate a workpiece's score on validation scenes",
    },
    "benchmark": {
        "perception": "PS6D, its peers and its ablations on held-out heaps",
        "motion": "cycle times beside their lower bound",
        "campaign": "attempts per hour and core, and time by stage",
        "gate": "error rates of the gate and coverage of the intervals",
    },
    "more": {
        "list": "list scenarios and workpieces",
        "completion": "print the completion script of a shell",
    },
}
"""Group -> command -> what it does. The folder has the name of the group, module and function that of the command."""
MAKES_FOLDER = "onboard"
"""The function of the command that creates the first folder of --workpieces."""


class NoCommandError(PickproofError):
    """The command line ends before a command is named."""


def typed_commands() -> list[str]:
    """Every command as it is typed after `pickproof`."""
    return [f"{group} {name}" if group in BELOW else name for group, names in COMMANDS.items() for name in names]


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
    for group, commands in COMMANDS.items():
        above = app
        if group in BELOW:
            title = groups.get(group, groups["workpiece"])
            above = App(name=group, help=BELOW[group], group=title, sort_key=0.5, help_format="plaintext")
            app.command(above)
        for i, (name, text) in enumerate(commands.items()):
            path = f"{_HERE}.{group}.{_python_name(name)}"
            above.command(path, name=name, help=text, group=None if above is not app else groups.get(group), sort_key=i)
    app.meta.end_of_options_delimiter = ""  # `--` is a word for the command
    app.meta.default(_launcher(app))
    return app


def _python_name(command: str) -> str:
    """MODULE:FUNCTION of a command in the folder of its group."""
    name = command.replace("-", "_") + "_" * (keyword.iskeyword(command) or hasattr(builtins, command))
    return f"{name}:{name}"


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
