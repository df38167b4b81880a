"""`python -m tests.benchmarks.artificial_votes`: what refinement makes of votes of a known quality."""

from __future__ import annotations

import argparse

import numpy as np

from pickproof.perception.evaluation.metrics import FrameScore, score_frame, summarise, visible_instances
from pickproof.perception.pose_estimate import PoseEstimate
from pickproof.perception.refinement.refine import RefineConfig, refine
from tests.perception import artificial

VOTES = ((0.03, 5, 0.05), (0.12, 25, 0.3), (0.15, 40, 0.55), (0.20, 55, 0.7), (0.12, 25, 1.0))
"""Median error of the centre [unit] and of the rotation [deg], and share of random rotations."""
FIRST_SEED = 1000
"""Of heaps that no test sees."""


def score(scene: artificial.Scene, estimates: list[PoseEstimate]) -> FrameScore:
    """Of the paper's metrics."""
    found = np.array([e.T_camera_part for e in estimates]).reshape(-1, 4, 4)
    return score_frame(found, scene.Ts_camera_part, visible_instances(scene.pixels), scene.workpiece)


def main() -> None:
    """Print one row of the table for each quality of votes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--heaps", type=int, default=4)
    parser.add_argument("--parts", type=int, default=24)
    parser.add_argument("--votes", type=int, default=1200)
    args = parser.parse_args()
    scores: dict[tuple[float, float, float], list[tuple[FrameScore, FrameScore]]] = {quality: [] for quality in VOTES}
    for seed in range(FIRST_SEED, FIRST_SEED + args.heaps):
        scene = artificial.heap(args.parts, seed)
        for quality in VOTES:
            votes = artificial.votes_of(scene, seed, *quality, count=args.votes)
            result = refine(scene.frame, scene.workpiece, votes, RefineConfig())
            scores[quality].append((score(scene, result.raw), score(scene, result.estimates)))
    print("| votes: median error, random rotations | two-stage F1 | F1 | precision | recall | median |")
    print("|---|---|---|---|---|---|")
    for (position, angle, outliers), seen in scores.items():
        raw, refined = (summarise([pair[i] for pair in seen]) for i in (0, 1))
        figures = " | ".join(
            f"{100 * x:.1f}" for x in (raw.f1_inst, refined.f1_inst, refined.precision, refined.recall)
        )
        median = f"{refined.median_mm:.2f} mm, {refined.median_deg:.2f} deg"
        print(f"| {position:.2f}, {angle} deg, {100 * outliers:.0f} % | {figures} | {median} |")


if __name__ == "__main__":
    main()
