"""`pickproof grasps edit WORKPIECE`: move, check, try and save grasps in the browser."""

from __future__ import annotations

import sys
import threading
from pathlib import Path
from typing import Annotated

from pickproof.cell.errors import InputError
from pickproof.scenarios.commands.arguments import FILE_TO_WRITE, WorkpieceName, about, integer

HOST = "127.0.0.1"


def edit(
    workpiece: WorkpieceName,
    /,
    *,
    gripper: Annotated[str | None, about("default: that of the workpiece's grasps.yaml")] = None,
    grasps: Annotated[Path | None, FILE_TO_WRITE, about("default: the workpiece's grasps.yaml")] = None,
    port: Annotated[int, integer(0, 65535), about("of the page")] = 8080,
    host: Annotated[str, about("address of this machine to listen on")] = HOST,
    token: Annotated[str | None, about("of the page's address, at least 16 characters; default: random")] = None,
) -> int:
    """`pickproof grasps edit WORKPIECE`."""
    from rich.console import Console

    from pickproof.cell.config import read_yaml
    from pickproof.scenarios.grasp_editor.editor import GraspEditor
    from pickproof.scenarios.grasp_trials.table_files import workpiece_and_gripper
    from pickproof.scenarios.pages.address import checked_token

    part, hand = workpiece_and_gripper(workpiece, gripper, grasps)
    path = grasps or part.folder / "grasps.yaml"
    if path.exists() and not path.is_file():
        raise InputError("command line", "--grasps", str(path), "a regular file")
    if path.is_file() and path.stat().st_size:
        read_yaml(path)  # only valid YAML can be edited
    editor = GraspEditor(part, hand, path, port, host, checked_token(token))
    Console().print(f"editing {path}\nopen {editor.url} in a browser; Ctrl-C ends", soft_wrap=True)
    try:
        threading.Event().wait()
    except KeyboardInterrupt:
        unsaved = editor.document.changed
        editor.close()
        if unsaved:
            print(f"pickproof: changes of {path} were not saved", file=sys.stderr)
    return 0
