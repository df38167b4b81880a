"""`pickproof replay DIR --attempt N`: one attempt in 3-D, or as a film."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Annotated

from pickproof.scenarios.commands.arguments import FILE_TO_WRITE, AttemptIndex, ResultsFolder, about, integer


def replay(
    directory: ResultsFolder,
    /,
    *,
    attempt: AttemptIndex,
    port: Annotated[int, integer(0, 65535), about("of the page on 127.0.0.1")] = 8080,
    record: Annotated[Path | None, FILE_TO_WRITE, about("write a film instead of a page: .gif, .mp4 or .png")] = None,
) -> int:
    """`pickproof replay DIR --attempt N`."""
    from rich.console import Console

    from pickproof.scenarios.replay.data import Replayed
    from pickproof.scenarios.replay.film import record as record_film

    console = Console()
    shown = Replayed.load(directory, attempt)
    if record:
        console.print(f"wrote {record_film(shown, record)}", soft_wrap=True)
        return 0
    from pickproof.scenarios.replay.page import ReplayPage

    page = ReplayPage(shown, port)
    console.print(f"attempt {shown.index}, {shown.outcome}: {page.url}   (Ctrl-C ends it)", soft_wrap=True)
    try:
        threading.Event().wait()
    finally:
        page.close()
    return 0
