"""Does `pickproof tune` regain what bad grasp points lose? `python -m tests.benchmarks.tuning --help`.

The grasp points of a workpiece are spoiled: each centre is moved by 6 mm in a direction drawn from the seed, the jaws
come 1 mm wider than the workpiece, and priorities are turned round. `tune` is given the spoiled table and nothing else.
The same unseen bins are then picked with the spoiled, the tuned and the shipped table. Exit code 1 where less than 90 %
of the success lost comes back, or the interval of the gain does not lie above zero.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.grasping.grasp_points import GraspPoint, read_table
from pickproof.scenarios.commands.cli import main as pickproof
from pickproof.scenarios.comparison.difference import Difference
from pickproof.scenarios.config.scenario import load_scenario
from pickproof.scenarios.files.grasps_text import table_text
from pickproof.scenarios.tuning.plan import HOLDOUT

SHIFT, LOOSE = 0.006, 0.001  # [m]
REGAINED = 0.9


def spoiled(points: list[GraspPoint], widest: float, rng: np.random.Generator) -> list[GraspPoint]:
    """Grasp points that are off in every way that tuning can mend."""
    bad = []
    for point in points:
        way = rng.standard_normal(3)
        centre = np.round(np.asarray(point.centre) + SHIFT * way / np.linalg.norm(way), 5)
        change = {"opening": min(point.width + LOOSE, widest), "stroke": None, "priority": round(1 - point.priority, 3)}
        bad.append(point.model_copy(update=change | {"centre": tuple(centre.tolist())}))
    return bad


@dataclass(frozen=True)
class Proof:
    """Pick success in unseen bins: tuned less spoiled, and with the shipped table."""

    gain: Difference
    shipped: float

    @property
    def regained(self) -> float:
        """Share of the success lost that came back; 1 where nothing was lost."""
        lost = self.shipped - self.gain.a
        return (self.gain.b - self.gain.a) / lost if lost > 0 else 1.0

    @property
    def holds(self) -> bool:
        return self.regained >= REGAINED and self.gain.interval95[0] > 0


def run(name: str, args: argparse.Namespace) -> Proof | None:
    """Spoil, tune, and pick the unseen bins; None where nothing better was found or the arm never moved."""
    scenario = load_scenario(name)
    workpiece, gripper = load_workpiece(scenario.workpiece), load_gripper(scenario.gripper)
    shipped = [p for p in read_table(workpiece.folder / "grasps.yaml").grasps if p.gripper in (None, gripper.name)]
    if args.grasps:
        shipped = [p for p in shipped if p.name in args.grasps.split(",")]
    folder = args.out / name
    folder.mkdir(parents=True)
    bad = spoiled(shipped, getattr(gripper, "max_opening", np.inf), np.random.default_rng(args.seed))
    for file, points in (("spoiled.yaml", bad), ("shipped.yaml", shipped)):
        (folder / file).write_text(table_text(points, gripper.name), encoding="utf-8")
        data = scenario.model_dump(mode="json", exclude_defaults=True) | {"grasps": file, "count": args.count}
        (folder / f"cell-{file}").write_text(yaml.safe_dump(data), encoding="utf-8")
    effort = [
        w for k in ("generations", "rounds", "episodes", "block", "holdout") for w in (f"--{k}", str(getattr(args, k)))
    ]
    words = ["--oracle", "perception", "--workers", str(args.workers)]
    if code := pickproof(["tune", str(folder / "cell-spoiled.yaml"), "--out", str(folder / "tune"), *effort, *words]):
        raise SystemExit(code)
    found = json.loads((folder / "tune" / "tune.json").read_text(encoding="utf-8"))["comparison"]
    seeds = ["--episodes", str(args.holdout), "--seed", str(scenario.seed + HOLDOUT)]
    pickproof(
        ["run", str(folder / "cell-shipped.yaml"), "--out", str(folder / "shipped"), "--no-pictures", *seeds, *words]
    )
    best = json.loads((folder / "shipped" / "summary.json").read_text(encoding="utf-8"))
    if not found or not found["success"] or best["success_rate"] is None:
        return None
    return Proof(Difference(**found["success"]), best["success_rate"])


def main() -> int:
    """Run it; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--workpieces", nargs="+", default=["bracket", "tless_20", "ps6d_7"], metavar="NAME")
    parser.add_argument("--grasps", default="", metavar="NAMES", help="of the shipped table, with commas; default all")
    parser.add_argument("--count", type=int, default=6, help="workpieces a bin (default 6)")
    for name, value in (("generations", 8), ("rounds", 4), ("episodes", 8), ("block", 2), ("holdout", 20)):
        parser.add_argument(f"--{name}", type=int, default=value, help=f"as of tune (default {value})")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0, help="of the directions in which grasps are spoiled")
    parser.add_argument("--out", type=Path, default=Path("out/tuning"))
    args = parser.parse_args()
    held = []
    for name in args.workpieces:
        proof = run(name, args)
        if proof is None:
            print(f"{name}: nothing better was found")
        else:
            low, high = (100 * v for v in proof.gain.interval95)
            print(
                f"{name}: pick success in unseen bins: spoiled {100 * proof.gain.a:.1f} %, tuned "
                f"{100 * proof.gain.b:.1f} % ({low:+.1f} to {high:+.1f} points), shipped {100 * proof.shipped:.1f} %; "
                f"{100 * proof.regained:.0f} % of the loss regained"
            )
        held.append(proof is not None and proof.holds)
    return int(not all(held))


if __name__ == "__main__":
    sys.exit(main())
