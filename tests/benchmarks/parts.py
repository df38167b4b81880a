"""CAD files onboarded and their bins emptied with perfect poses: `python -m tests.benchmarks.parts DIR`.

Each file becomes a workpiece by `pickproof onboard --yes`, and its scenario runs N bins with `--oracle perception`.
What is done is kept in the folder of --out, so that a run which was interrupted goes on where it was; log.txt there has
the words of every command. The table, and parts.json, have a row for each file: pieces, grasps, picks, clearance, or
why it was refused. Exit code 1 if a part is under the limits of --picked and --cleared.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from pickproof.scenarios.files.atomic import write_json

SUFFIXES = (".stl", ".obj", ".ply", ".glb", ".step", ".stp")
SEED = 93_000
"""Of the first bin: none that anything was chosen on."""


@dataclass
class Row:
    """One file: what came of it, empty or None where it did not come so far."""

    file: str
    refused: str = ""
    mass_g: float | None = None
    pieces: int | None = None
    off_mm: float | None = None
    bound_mm: float | None = None
    gripper: str | None = None
    grasps: int | None = None
    iterations: int | None = None
    onboard_s: float | None = None
    attempts: int | None = None
    successes: int | None = None
    clearance: float | None = None
    reasons: dict[str, int] | None = None
    ends: dict[str, int] | None = None

    @property
    def picked(self) -> float:
        """Share of attempts; 0 without any."""
        return (self.successes or 0) / self.attempts if self.attempts else 0.0


@dataclass(frozen=True)
class Bench:
    """The folder of results, and what is done with each file."""

    out: Path
    units: dict[str, str]
    materials: dict[str, str]
    bins: int

    def row(self, file: Path) -> Row:
        """The row of a file, from results that are there already as far as they go."""
        name = re.sub(r"[^A-Za-z0-9_-]", "_", file.stem + ("_stp" if file.suffix == ".stp" else ""))
        kept = self.out / "rows" / f"{name}.json"
        if kept.is_file():
            return Row(**json.loads(kept.read_text(encoding="utf-8")))
        row = Row(file.name)
        self._onboard(file, name, row)
        if not row.refused and (self.out / "workpieces" / name / "scenario.yaml").is_file():
            self._run(name, row)
        write_json(kept, asdict(row))
        return row

    def _onboard(self, file: Path, name: str, row: Row) -> None:
        record = self.out / "workpieces" / name / "onboard.json"
        if not record.is_file():
            told = self._pickproof(
                "onboard", str(file), "--unit", self.units.get(file.name, "mm"), "--name", name, "--yes",
                "--material", self.materials.get(file.name, "abs"),
            )  # fmt: skip
            if told:
                row.refused = told
                return
        found = json.loads(record.read_text(encoding="utf-8"))
        pieces, physics = found["pieces"], found["physics"]
        row.mass_g = round(1000 * found["mass"], 2)
        row.pieces, row.bound_mm = pieces["count"], round(pieces["bound_mm"], 2)
        row.off_mm = round(max(pieces["outside_mm"], pieces["felt_mm"]), 2)
        row.gripper, row.grasps = found["gripper"], found["grasps"]
        row.iterations = physics["iterations"] if physics else None
        row.onboard_s = round(found["cpu_s"], 1)

    def _run(self, name: str, row: Row) -> None:
        folder = self.out / "runs" / name
        resume = ["--resume"] if folder.is_dir() else []
        told = self._pickproof(
            "run", name, "--oracle", "perception", "--episodes", str(self.bins), "--seed", str(SEED), "--workers", "1",
            "--no-pictures", "--keep", "none", "--out", str(folder), *resume,
        )  # fmt: skip
        if told:
            row.refused = f"run: {told}"
            return
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        row.attempts, row.successes = summary["attempts"], summary["successes"]
        row.clearance, row.reasons, row.ends = summary["clearance"], summary["reasons"], summary["ends"]

    def _pickproof(self, *words: str) -> str:
        """Run a command and log it; its last line of errors where it fails."""
        command = [sys.executable, "-m", "pickproof", *words, "--workpieces", str(self.out / "workpieces")]
        done = subprocess.run(command, capture_output=True, text=True, env=dict(os.environ), check=False)
        with (self.out / "log.txt").open("a", encoding="utf-8") as log:
            log.write(f"$ pickproof {' '.join(words)}\n{done.stdout}{done.stderr}exit code {done.returncode}\n")
        return "" if done.returncode == 0 else (done.stderr.strip().splitlines() or ["no words"])[-1]


def table(rows: list[Row]) -> Table:
    """The rows as text."""
    made = Table(title="CAD files, perfect poses")
    for head in ("file", "g", "pieces", "off / bound, mm", "gripper", "grasps", "iterations", "cpu, s", "picked of",
                 "cleared", "failures, ends"):  # fmt: skip
        made.add_column(head, no_wrap=head == "file")
    for row in rows:
        if row.refused:
            made.add_row(row.file, *[""] * 9, row.refused)
            continue
        failures = ", ".join(f"{k} {v}" for counts in (row.reasons, row.ends) for k, v in (counts or {}).items())
        picks = "" if row.attempts is None else f"{row.successes} of {row.attempts}"
        cleared = "" if row.clearance is None else f"{100 * row.clearance:.0f} %"
        made.add_row(
            row.file, f"{row.mass_g:g}", str(row.pieces), f"{row.off_mm} / {row.bound_mm}", row.gripper or "none",
            str(row.grasps), str(row.iterations), str(row.onboard_s), picks, cleared, failures,
        )  # fmt: skip
    return made


def pairs(words: list[str]) -> dict[str, str]:
    """`FILE=WORD` each."""
    return dict(word.split("=", 1) for word in words)


def main() -> int:
    """0 if all parts are over the limits, 1 if one is not."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, metavar="DIR", help="of CAD files")
    parser.add_argument("--out", type=Path, default=Path("out/parts"), help="default out/parts; goes on where it was")
    parser.add_argument("--bins", type=int, default=4, help="of each part, default 4")
    parser.add_argument("--only", nargs="+", metavar="FILE", help="names of files in DIR")
    parser.add_argument("--unit", nargs="+", default=[], metavar="FILE=UNIT", help="default mm")
    parser.add_argument("--material", nargs="+", default=[], metavar="FILE=NAME", help="default abs")
    parser.add_argument("--picked", type=float, default=0.92, help="least share of attempts, default 0.92")
    parser.add_argument("--cleared", type=float, default=0.85, help="least share of parts dropped, default 0.85")
    args = parser.parse_args()
    files = sorted(path for path in args.folder.iterdir() if path.suffix.lower() in SUFFIXES)
    files = [path for path in files if not args.only or path.name in args.only]
    for folder in ("rows", "workpieces"):
        (args.out / folder).mkdir(parents=True, exist_ok=True)
    bench = Bench(args.out, pairs(args.unit), pairs(args.material), args.bins)
    rows, console = [], Console(width=None if sys.stdout.isatty() else 200)
    for file in files:
        rows.append(bench.row(file))
        last = rows[-1]
        console.print(f"{file.name}: {last.refused or f'{last.successes} of {last.attempts}'}", markup=False)
        write_json(args.out / "parts.json", {"bins": args.bins, "seed": SEED, "parts": [asdict(row) for row in rows]})
    console.print(table(rows))
    good = [row for row in rows if row.picked >= args.picked and (row.clearance or 0.0) >= args.cleared]
    return 0 if len(good) == len([row for row in rows if not row.refused]) else 1


if __name__ == "__main__":
    raise SystemExit(main())
