"""The committed record hashes hold on this machine: what every machine must reproduce."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from cell.numerics import SWITCH
from scenarios.inputs import changed

ROOT = Path(__file__).resolve().parents[2]
GOLDEN = json.loads((ROOT / "tests" / "benchmarks" / "golden.json").read_text(encoding="utf-8"))
_SOFTWARE = "import json; from tests.benchmarks.golden import software; print(json.dumps(software()))"
_HASH = "import sys; from tests.benchmarks.golden import CAMPAIGNS; print(CAMPAIGNS[sys.argv[1]].record_hash())"


def run(code: str, *words: str) -> str:
    """In a fresh process, which takes the portable profile whatever this one was told."""
    environment = {name: value for name, value in os.environ.items() if name != SWITCH}
    done = subprocess.run(
        [sys.executable, "-c", code, *words], cwd=ROOT, env=environment, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[-1]


@pytest.mark.parametrize("name", sorted(GOLDEN["hashes"]))
def test_every_machine_gives_these_hashes(name: str) -> None:
    other = changed(GOLDEN["versions"], json.loads(run(_SOFTWARE)))
    if other:  # a newer library may compute otherwise
        pytest.skip(f"other versions than constraints.txt has: {', '.join(other)}")
    assert run(_HASH, name) == GOLDEN["hashes"][name]
