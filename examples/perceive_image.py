"""Poses of workpieces in a depth image from a file, or in a simulated heap if no file is given.

python examples/perceive_image.py
python examples/perceive_image.py --image depth.png   # with depth.json beside it, as DepthFrame.save writes both
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pickproof.cell import DepthFrame, load_workpiece
from pickproof.cell.sensing.sensor_model import measure
from pickproof.perception import Perception
from pickproof.perception.data.region import region_of_interest
from pickproof.perception.data.scenes import render_heap, settle_heap, tilted_view


def simulated(name: str, count: int, seed: int) -> DepthFrame:
    """A measured frame of a settled heap of `count` workpieces."""
    workpiece = load_workpiece(name)
    workpiece = replace(workpiece, heap=workpiece.heap.model_copy(update={"count": (count, count)}))
    rng = np.random.default_rng(seed)
    view = tilted_view(workpiece, rng)
    exact = render_heap(workpiece, settle_heap(workpiece, seed), view)
    return measure(exact, view.intrinsics, view.T_world_camera, view.sensor, rng)


def main(words: Sequence[str] | None = None) -> int:
    """Print one line a pose; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workpiece", default="bracket")
    parser.add_argument("--image", type=Path, help="16-bit PNG that DepthFrame.save wrote")
    parser.add_argument("--count", type=int, default=8, help="workpieces of the simulated heap")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args(words)

    workpiece = load_workpiece(args.workpiece)
    frame = DepthFrame.load(args.image) if args.image else simulated(args.workpiece, args.count, args.seed)
    region = region_of_interest(frame, workpiece)
    found = Perception.load(workpiece).perceive_region(frame, region, np.random.default_rng(args.seed))
    for e in found.estimates:  # best score first
        x, y, z = (frame.T_world_camera @ e.T_camera_part)[:3, 3]
        print(f"x {x:+.4f} y {y:+.4f} z {z:+.4f} m   score {e.score:.2f}   visible {100 * e.visible_share:.0f} %")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
