"""Pages that mkdocs does not check: field tables, links of the README, and pages that the program names."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parents[1]
TOP_PAGES = ("README.md", "CONTRIBUTING.md")
ROOMS = ("cell", "perception", "grasping", "robots", "scenarios", "examples", "tests")
NAMED = re.compile(r"docs/[\w/-]+\.md")
OF_BOP = "docs/bop_datasets_format.md"
"""A page of the BOP toolkit."""


def fields() -> ModuleType:
    """docs/fields.py, which belongs to no package."""
    spec = importlib.util.spec_from_file_location("fields", ROOT / "docs" / "fields.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_tables_of_fields_are_what_the_schemas_say() -> None:
    assert [path.name for path in fields().stale()] == [], "run python docs/fields.py"


def test_every_field_has_a_meaning() -> None:
    pages = sorted((ROOT / "docs" / "reference").glob("*-file.md"))
    bare = [
        f"{page.name}: {row}"
        for page in pages
        for block in fields().BLOCK.finditer(page.read_text())
        for row in block[0].splitlines()
        if row.endswith("|  |")
    ]
    assert pages and not bare


def test_links_of_the_top_pages_lead_somewhere() -> None:
    for name in TOP_PAGES:
        links = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", (ROOT / name).read_text())
        assert [link for link in links if "://" not in link and not (ROOT / link).exists()] == []


def test_pages_that_the_program_names_exist() -> None:
    files = [path for room in ROOMS for kind in ("*.py", "*.yaml", "*.html") for path in (ROOT / room).rglob(kind)]
    named = {page for file in files for page in NAMED.findall(file.read_text()) if page != OF_BOP}
    assert named
    assert sorted(page for page in named if not (ROOT / page).is_file()) == []
