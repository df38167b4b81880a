"""A part of your own: from a mesh file to a campaign.

python examples/own_part.py                       # a bar of 50 x 24 x 14 mm
python examples/own_part.py --mesh part.stl --unit mm --name part
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

import trimesh

from pickproof import Campaign, load_scenario
from pickproof.scenarios.commands.cli import main as pickproof


def main(words: Sequence[str] | None = None) -> int:
    """`pickproof onboard`, then a campaign; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mesh", type=Path, help="STL, PLY, OBJ, GLB or STEP; default: a bar")
    parser.add_argument("--unit", default="mm", choices=("mm", "cm", "m", "inch"))
    parser.add_argument("--name", default="bar")
    parser.add_argument("--episodes", type=int, default=2)
    parser.add_argument("--count", type=int, default=6, help="workpieces a bin")
    parser.add_argument("--folder", type=Path, default=Path("out/parts"), help="folder of own workpieces")
    args = parser.parse_args(words)

    args.folder.mkdir(parents=True, exist_ok=True)
    mesh, replacing = args.mesh, []
    if mesh is None:
        mesh, replacing = args.folder / "bar.stl", ["--replace"]  # remove the results of an earlier run
        trimesh.creation.box((50, 24, 14)).export(mesh)
    # mesh check, symmetry, collision pieces, grasps tried in the physics, a cell; onboard.html shows all of it
    onboard = ["onboard", str(mesh), "--unit", args.unit, "--name", args.name, "--workpieces", str(args.folder)]
    if code := pickproof([*onboard, "--yes", *replacing]):
        return code
    os.environ["PICKPROOF_WORKPIECES"] = str(args.folder)  # scenarios and workpieces are searched here first
    scenario = load_scenario(args.name, [f"count={args.count}"])
    # there are no weights yet (`pickproof train` makes them), so poses come from ground truth
    campaign = Campaign.run(scenario, episodes=args.episodes, oracle=["perception"], out=args.folder / "campaign")
    rate, clearance = campaign.summary["success_rate"], campaign.summary["clearance"]
    print(f"pick success {rate}, clearance {clearance}, results in {campaign.directory}")
    return 0


if __name__ == "__main__":  # the worker processes of a campaign import this file
    raise SystemExit(main())
