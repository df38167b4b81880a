"""The imports of the tree: no circles, lazy ones and those for type checking included."""

from __future__ import annotations

import ast
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("cell", "perception", "grasping", "robots", "scenarios")


@pytest.fixture(scope="module")
def graph() -> dict[str, set[str]]:
    """Module -> modules of the project that it imports."""
    found = grimp.build_graph("pickproof", cache_dir=None)
    return {module: found.find_modules_directly_imported_by(module) for module in found.modules}


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Sets of more than one module each of which reaches all others of it (Tarjan)."""
    order: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(module: str) -> None:
        order[module] = low[module] = len(order)
        stack.append(module)
        for other in sorted(graph.get(module, ())):
            if other not in order:
                visit(other)
                low[module] = min(low[module], low[other])
            elif other in stack:
                low[module] = min(low[module], order[other])
        if low[module] == order[module]:
            at = stack.index(module)
            if len(stack) - at > 1:
                found.append(sorted(stack[at:]))
            del stack[at:]

    for module in sorted(graph):
        if module not in order:
            visit(module)
    return found


def test_a_circle_is_found_where_there_is_one() -> None:
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}) == [["b", "c"]]


def test_no_circle(graph: dict[str, set[str]]) -> None:
    assert len(graph) > 300
    assert circles(graph) == []


def test_no_circle_between_folders(graph: dict[str, set[str]]) -> None:
    folders: dict[str, set[str]] = {}
    for module, imported in graph.items():
        folder = module.rpartition(".")[0]
        folders.setdefault(folder, set()).update(other.rpartition(".")[0] for other in imported)
    rooms = {f: {g for g in to if g != f and g.count(".") >= 2} for f, to in folders.items() if f.count(".") >= 2}
    assert circles(rooms) == []


def test_every_import_goes_by_pickproof() -> None:
    """A folder's own name would be a second copy of its modules, and collides with modules of others."""
    bare = []
    for room in (*ROOMS, "tests", "pickproof"):
        for file in (ROOT / room).rglob("*.py"):
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                names = []
                if isinstance(node, ast.Import):
                    names = [alias.name for alias in node.names]
                elif isinstance(node, ast.ImportFrom):
                    names = [node.module or "a relative import"]
                bare += [
                    f"{file}:{node.lineno}: {n}" for n in names if n.split(".")[0] in ROOMS or n == "a relative import"
                ]
    assert not bare
