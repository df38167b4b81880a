"""Hostile inputs of every kind: `python -m tests.benchmarks.fuzz --cases 2000`.

Each case is a damaged or doubtful file or command line, drawn by its seed. It must be read to the right value, or
refused in one line; a traceback or a silent error of unit ends the run with exit code 1, and the file stays.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.progress import track

from tests.fuzzing import arguments, cameras, clouds, meshes, yaml_files

Case = Callable[[np.random.Generator, Path], str]


def _file(hostile: Callable[[np.random.Generator], tuple[str, bytes]], check: Callable[[Path], str]) -> Case:
    def case(rng: np.random.Generator, folder: Path) -> str:
        suffix, content = hostile(rng)
        path = folder / f"case{suffix}"
        path.write_bytes(content)
        said = check(path)
        path.unlink()
        return said

    return case


def _words(rng: np.random.Generator, folder: Path) -> str:
    return arguments.check(arguments.hostile(rng), folder)


KINDS: dict[str, Case] = {
    "meshes": _file(meshes.hostile_mesh, meshes.check_mesh_file),
    "cameras": _file(cameras.hostile, cameras.check),
    "clouds": _file(clouds.hostile, clouds.check),
    "yaml": _file(yaml_files.hostile, yaml_files.check),
    "arguments": _words,
}


def main() -> int:
    """0 if every case was read or refused, 1 at the first that was not."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=2000, metavar="N", help="of all kinds together (default 2000)")
    parser.add_argument("--seed", type=int, default=0, help="of the first case")
    parser.add_argument("--only", nargs="+", choices=list(KINDS), default=list(KINDS), metavar="KIND")
    args = parser.parse_args()
    counts: Counter[tuple[str, str]] = Counter()
    folder = Path(tempfile.mkdtemp(prefix="pickproof-fuzz-"))
    for i in track(range(args.cases), description="cases"):
        kind = args.only[i % len(args.only)]
        try:
            counts[kind, KINDS[kind](np.random.default_rng((args.seed, i)), folder)] += 1
        except AssertionError as error:
            print(f"{kind}, seed {args.seed}, case {i}: {error}\nthe file stays in {folder}", file=sys.stderr)
            return 1
    shutil.rmtree(folder)
    for (kind, said), n in sorted(counts.items()):
        print(f"{kind:10} {said:8} {n}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
