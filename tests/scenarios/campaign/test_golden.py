"""The committed record hashes hold on this machine: what every machine must reproduce."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from pickproof.cell.numerics import SWITCH
from pickproof.scenarios.config.input_hashes import changed

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[3]
GOLDEN = json.loads((ROOT / "tests" / "benchmarks" / "golden.json").read_text(encoding="utf-8"))
_GROUPS = [[name for name in sorted(GOLDEN["hashes"]) if ("ps6d" in name) == ps6d] for ps6d in (False, True)]
"""Those that load torch, and the others: a process for each group, as loading takes longer than the picks."""
_HASHES = """
import json, sys
from tests.benchmarks.golden import CAMPAIGNS, software
print(json.dumps([software(), {name: CAMPAIGNS[name].record_hash() for name in sys.argv[1:]}]))
"""


@pytest.mark.parametrize("names", _GROUPS, ids=lambda names: "+".join(names))
def test_every_machine_gives_these_hashes(names: list[str]) -> None:
    """In a fresh process, which takes the portable profile whatever this one was told."""
    environment = {name: value for name, value in os.environ.items() if name != SWITCH}
    done = subprocess.run(
        [sys.executable, "-c", _HASHES, *names], cwd=ROOT, env=environment, capture_output=True, text=True, timeout=900
    )
    assert done.returncode == 0, done.stderr
    software, hashes = json.loads(done.stdout.splitlines()[-1])
    other = changed(GOLDEN["versions"], software)
    if other:  # a newer library may compute otherwise
        pytest.skip(f"other versions than constraints.txt has: {', '.join(other)}")
    assert names and hashes == {name: GOLDEN["hashes"][name] for name in names}
