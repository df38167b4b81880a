"""The same picks on other processors: `python -m tests.benchmarks.portable`.

Runs the small campaigns of `golden.py` in this process's own Python, natively and under processors that QEMU emulates
(Debian's qemu-user, 7.2 or newer), one of each maker, and compares their record hashes with golden.json. `--only NAME`
takes some of the campaigns: an emulated processor is 10 to 40 times slower.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

from tests.benchmarks.golden import CAMPAIGNS, FILE

ROOT = Path(__file__).resolve().parents[2]
PROCESSORS = {"Haswell": "Intel", "EPYC": "AMD"}
"""Models that QEMU emulates, and their makers."""
_ONE = "import sys; from tests.benchmarks.golden import CAMPAIGNS; print(CAMPAIGNS[sys.argv[1]].record_hash())"


def main() -> int:
    """0 if all processors agree with golden.json, 1 if one does not, 2 without QEMU."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=list(CAMPAIGNS), default=list(CAMPAIGNS), metavar="NAME")
    models = "as `qemu-x86_64 -cpu help` lists them"
    parser.add_argument("--processors", nargs="+", default=list(PROCESSORS), metavar="MODEL", help=models)
    args = parser.parse_args()
    qemu = shutil.which("qemu-x86_64")
    if qemu is None:
        print("portable: no qemu-x86_64: install Debian's qemu-user", file=sys.stderr)
        return 2
    golden = json.loads(FILE.read_text(encoding="utf-8"))["hashes"]
    agree = True
    for name in args.only:
        for model in ("native", *args.processors):
            prefix = [] if model == "native" else [qemu, "-cpu", model]
            begun = time.monotonic()
            done = subprocess.run(
                [*prefix, sys.executable, "-c", _ONE, name], cwd=ROOT, capture_output=True, text=True, check=False
            )
            found = done.stdout.split()[-1] if done.returncode == 0 else f"failed: {done.stderr.strip()[-200:]}"
            same = found == golden[name]
            agree = agree and same
            maker = PROCESSORS.get(model, "")
            word = "equal" if same else "DIFFERS"
            print(f"{name:14} {model:10} {maker:6} {found[:16]} {word} {time.monotonic() - begun:6.0f} s", flush=True)
    return 0 if agree else 1


if __name__ == "__main__":
    sys.exit(main())
