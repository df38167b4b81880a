"""The command line.

Exit codes: 0 done, 1 a gate failed, 2 bad input, 3 undecided, 70 internal error, 130 interrupted. Only a gate returns
    1; Python itself would return 1 for a traceback.
"""

from __future__ import annotations

import os
import sys
import tempfile
import traceback
from collections.abc import Sequence

from cyclopts import CycloptsError

from pickproof.cell.errors import PickproofError
from pickproof.scenarios.commands.invocation import invoked_with
from pickproof.scenarios.commands.refusal import refusal
from pickproof.scenarios.commands.registry import build_app
from pickproof.scenarios.commands.streams import lasting_streams, to_nowhere

INTERNAL = 70
"""EX_SOFTWARE of sysexits.h: an unexpected exception."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code. A closed reader of the output does not change it."""
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
        with invoked_with(words):
            code = build_app().meta(words, exit_on_error=False, print_error=False, result_action="return_value")
        return code if isinstance(code, int) else 0  # help and version return nothing
    except SystemExit as leaving:
        return leaving.code if isinstance(leaving.code, int) else 0 if leaving.code is None else INTERNAL
    except CycloptsError as error:
        print(f"pickproof: error: {refusal(error)}", file=sys.stderr)
        return 2
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
    """Text that names the file of the traceback; empty where no file can be written."""
    try:
        handle, file = tempfile.mkstemp(prefix="pickproof-", suffix=".txt")
        with os.fdopen(handle, "w", encoding="utf-8", errors="backslashreplace") as out:
            traceback.print_exception(error, file=out)
    except OSError:
        return ""
    return f"; the traceback is in {file}"


if __name__ == "__main__":
    sys.exit(main())
