"""The shape of the code: few arguments, short files. Rules that a reader can check by eye."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from statistics import median

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("cell", "perception", "grasping", "robots", "scenarios")
MOST_ARGUMENTS = 8
MOST_LINES, MEDIAN_LINES = 400, 130


def files() -> Iterator[Path]:
    for room in ROOMS:
        yield from sorted((ROOT / room).rglob("*.py"))


def compiled(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Decorated by `numba.njit`: inner loops hand on scalars."""
    return any("njit" in ast.unparse(decorator) for decorator in function.decorator_list)


def arguments(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Number of arguments, `self` and `cls` not counted."""
    a = function.args
    names = [x.arg for x in (*a.posonlyargs, *a.args, *a.kwonlyargs)]
    return len(names) - (names[:1] in (["self"], ["cls"]))


def test_no_function_takes_more_than_eight_arguments() -> None:
    """More are handed over in a frozen dataclass."""
    found = [
        f"{file.relative_to(ROOT)}:{node.lineno} {node.name}: {arguments(node)}"
        for file in files()
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        if arguments(node) > MOST_ARGUMENTS and not compiled(node)
    ]
    assert not found


def test_files_are_short() -> None:
    texts = {file.relative_to(ROOT): file.read_text(encoding="utf-8") for file in files() if file.name != "__init__.py"}
    lengths = {str(file): len(text.splitlines()) for file, text in texts.items()}
    assert len(lengths) > 300
    assert not {file: n for file, n in lengths.items() if n > MOST_LINES}
    assert median(lengths.values()) <= MEDIAN_LINES
