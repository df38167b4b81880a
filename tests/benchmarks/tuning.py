"""Does `pickproof tune` regain what bad grasp points lose? `python -m tests.benchmarks.tuning --help`.

The grasp points of a workpiece are spoiled: each centre is moved by 6 mm in a direction drawn from the seed, the jaws
come 1 mm wider than the workpiece, and priorities are turned round. `tune` is given the spoiled table and nothing else.
The same unseen bins are then picked with the spoiled, the tuned and the shipped table. Exit code 1 where tuning lost.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np
import yaml

from cell.gripper import load_gripper
from cell.workpiece import load_workpiece
from grasping.grasp_points import GraspPoint, read_table
from scenarios.cli import main as pickproof
from scenarios.grasps import table_text
from scenarios.scenario import load_scenario
from scenarios.tune_plan import HOLDOUT

SHIFT, LOOSE = 0.006, 0.001  # [m]


def spoiled(points: list[GraspPoint], widest: float, rng: np.random.Generator) -> list[GraspPoint]:
    """Grasp points that are off in every way that tuning can mend."""
    bad = []
    for point in points:
        way = rng.standard_normal(3)
        centre = np.round(np.asarray(point.centre) + SHIFT * way / np.linalg.norm(way), 5)
        change = {"opening": min(point.width + LOOSE, widest), "stroke": None, "priority": round(1 - point.priority, 3)}
        bad.append(point.model_copy(update=change | {"centre": tuple(centre.tolist())}))
    return bad


def run(name: str, args: argparse.Namespace) -> tuple[float | None, float | None, float | None]:
    """Pick success in unseen bins with the spoiled, the tuned and the shipped table; None where the arm never moved."""
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
    rates = found and (found["success"] or found["first_attempts"])
    return (rates["a"], rates["b"], best["success_rate"]) if rates else (None, None, best["success_rate"])


def main() -> int:
    """Run it; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--workpieces", nargs="+", default=["bracket", "ps6d_24", "tless_20"], metavar="NAME")
    parser.add_argument("--grasps", default="", metavar="NAMES", help="of the shipped table, with commas; default all")
    parser.add_argument("--count", type=int, default=6, help="workpieces a bin (default 6)")
    for name, value in (("generations", 8), ("rounds", 4), ("episodes", 8), ("block", 2), ("holdout", 20)):
        parser.add_argument(f"--{name}", type=int, default=value, help=f"as of tune (default {value})")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0, help="of the directions in which grasps are spoiled")
    parser.add_argument("--out", type=Path, default=Path("out/tuning"))
    args = parser.parse_args()
    lost = False
    for name in args.workpieces:
        rates = run(name, args)
        shown = ", ".join(
            f"{k} {'-' if r is None else f'{100 * r:.1f} %'}"
            for k, r in zip(("spoiled", "tuned", "shipped"), rates, strict=True)
        )
        print(f"{name}: pick success in unseen bins: {shown}")
        lost |= rates[1] is None or rates[0] is None or rates[1] <= rates[0]
    return int(lost)


if __name__ == "__main__":
    sys.exit(main())
