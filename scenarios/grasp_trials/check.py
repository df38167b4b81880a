"""Trials of all grasp points on a single workpiece, in each of its resting poses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from typing import Any

import numpy as np
from rich.table import Table

from pickproof.cell.frames import Array, about_axis, invert, make_transform
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.grippers.parallel_jaw import ParallelJaw
from pickproof.cell.workpiece.resting_poses import resting_poses
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.grasping.candidates import GraspCandidate, PartEstimates, PickScene, select
from pickproof.grasping.grasp_points import GraspPoint, expand
from pickproof.grasping.ranking import GraspingConfig
from pickproof.scenarios.grasp_trials.trial import FREE, PlacedGrasp, TrialCell, robust_share

NOTHING = np.zeros((0, 3))
IN_THE_AIR = 0.5
"""[m] height over the table at which a grasp is tried that no resting pose allows."""
NOVELTY = 0.02
"""Weight of a new approach direction relative to the probability of a resting pose."""


def check_grasp_points(
    workpiece: Workpiece, gripper: Gripper, points: Sequence[GraspPoint]
) -> tuple[list[dict[str, Any]], int]:
    """One row for each grasp point and resting pose, and the number of resting poses.

    A row has `grasp`, `resting` (index, likeliest first), `verdict` (`holds`, what went wrong in the physics, or the
    first reason why the gripper cannot go there), `slip_mm` and `turn_deg` of what was held.
    """
    rows = []
    with closing(TrialCell(workpiece, gripper)) as cell:
        resting = cell.resting_poses()
        for point in points:
            for k, T_world_part in enumerate(resting):
                row: dict[str, Any] = {"grasp": point.name, "resting": k, "slip_mm": None, "turn_deg": None}
                best = best_candidate(point, T_world_part, workpiece, gripper)
                if isinstance(best, str):
                    rows.append(row | {"verdict": best})
                    continue
                trial = cell.try_grasp(T_world_part, best.T_world_tool, best.opening)
                held = {"slip_mm": round(1000 * trial.slip, 3), "turn_deg": round(float(np.rad2deg(trial.turn)), 3)}
                rows.append(row | {"verdict": "holds", **held} if trial.held else row | {"verdict": trial.reason})
    return rows, len(resting)


def tried(
    workpiece: Workpiece,
    gripper: Gripper,
    points: Sequence[GraspPoint],
    least: float = 0.5,
    iterations: int | None = None,
) -> list[GraspPoint]:
    """Of proposed grasp points those that tolerate more than the share `least` of pose errors, most robust first.

    Args:
        iterations: of the contact solver, as in `TrialCell`.
    """
    kept = []
    with closing(TrialCell(workpiece, gripper, iterations)) as cell:
        resting = cell.resting_poses()
        for point in points:
            share = _robustness(cell, resting, point)
            if share > least:
                kept.append(point.model_copy(update={"robustness": round(share, 2), "priority": round(share, 2)}))
    return sorted(kept, key=lambda p: -p.robustness)


def in_order_of_use(workpiece: Workpiece, gripper: Gripper, points: Sequence[GraspPoint]) -> list[GraspPoint]:
    """Grasp points sorted to cover resting poses: first those for resting poses with the fewest points before.

    A point covers a resting pose if the gripper can reach it there. Each next point adds the largest probability of
    resting poses with the fewest points so far; if none adds any, it is the one whose approach is farthest from all
    before.
    """
    resting = resting_poses(workpiece.mesh, workpiece.symmetry)
    chance = np.array([r.probability for r in resting])
    serves = np.array(
        [[isinstance(best_candidate(p, r.T_plane_part, workpiece, gripper), GraspCandidate) for r in resting]
         for p in points], dtype=bool,
    ).reshape(len(points), len(resting))  # fmt: skip
    approaches = np.array([p.approach for p in points]).reshape(-1, 3)
    images = np.einsum("sij,nj->sni", workpiece.symmetry.rotations(), approaches)
    nearness = np.einsum("sni,mi->snm", images, approaches).max(axis=0)
    left, order, served, near = list(range(len(points))), [], np.zeros(len(resting)), np.full(len(points), -1.0)
    while left:
        gains = serves[left] @ (chance / (1 + served)) - NOVELTY * near[left]
        best = left.pop(int(np.argmax(gains)))
        order.append(points[best])
        served, near = served + serves[best], np.maximum(near, nearness[best])
    return order


def best_candidate(
    point: GraspPoint, T_world_part: Array, workpiece: Workpiece, gripper: Gripper
) -> GraspCandidate | str:
    """The best pose of one grasp point on a single workpiece; else the most frequent verdict on its poses."""
    found = candidates_of(point, T_world_part, workpiece, gripper)
    return found if isinstance(found, str) else found[0]


def candidates_of(
    point: GraspPoint, T_world_part: Array, workpiece: Workpiece, gripper: Gripper
) -> list[GraspCandidate] | str:
    """The poses of one grasp point with room on a workpiece that lies alone, best first; else as `best_candidate`."""
    poses = expand((point,), workpiece)
    scene = PickScene(workpiece, gripper, FREE, NOTHING)
    one = select(PartEstimates(T_world_part[None], np.ones(1)), poses, scene, GraspingConfig())
    if one.candidates:
        return one.candidates
    counts = one.ruled_out[0][point.name]
    return max(counts, key=lambda verdict: counts[verdict])


def check_table(rows: Sequence[dict[str, Any]], resting: int) -> Table:
    """Grasp points against resting poses."""
    table = Table(title="a single workpiece in its resting poses, likeliest first; slip in mm", title_justify="left")
    table.add_column("grasp point", no_wrap=True)
    for k in range(resting):
        table.add_column(f"pose {k}")
    for name in dict.fromkeys(row["grasp"] for row in rows):
        mine = {row["resting"]: row for row in rows if row["grasp"] == name}
        table.add_row(name, *(_cell(mine[k]) for k in range(resting)))
    return table


def _cell(row: dict[str, Any]) -> str:
    if row["verdict"] == "holds":
        return f"[green]holds[/green] {row['slip_mm']:.2f}"
    return str(row["verdict"])


def lying(
    point: GraspPoint, resting: Array, workpiece: Workpiece, gripper: Gripper, turned: bool = True
) -> Iterator[tuple[int, list[GraspCandidate]]]:
    """Index of each resting pose (k, 4, 4) that leaves the gripper room for a grasp, and its candidates there.

    If the grasp points sideways or up in all resting poses, the result is `turned`: the limit on tilt is dropped and
    the grasp is still tried, because in a heap workpieces have any orientation.
    """
    for loose in (point, _leaning(point)) if turned else (point,):
        found = [(k, candidates_of(loose, T, workpiece, gripper)) for k, T in enumerate(resting)]
        with_room = [(k, candidates) for k, candidates in found if not isinstance(candidates, str)]
        if with_room:
            yield from with_room
            return


def _robustness(cell: TrialCell, resting: Array, point: GraspPoint) -> float:
    """Share of pose errors under which the grasp holds, in the likeliest resting pose that leaves the gripper room.

    If the grasp points sideways or up in all resting poses, jaws grip the workpiece in the air, upright under the
    gripper and without gravity until it is gripped, because in a heap workpieces have any orientation.
    """
    jaws = isinstance(cell.gripper, ParallelJaw)
    for k, (best, *_) in lying(point, resting, cell.workpiece, cell.gripper, turned=not jaws):
        return robust_share(cell, PlacedGrasp(resting[k], best.T_world_tool, best.opening))
    if not jaws:
        return 0.0
    poses = expand((point,), cell.workpiece)
    first = int(np.argmin(poses.depth_rank + poses.offset))
    T_world_tool = make_transform(t=(0.0, 0.0, IN_THE_AIR)) @ about_axis((1, 0, 0), np.array(np.pi))
    T_world_part = T_world_tool @ invert(poses.Ts_part_tool[first])
    return robust_share(cell, PlacedGrasp(T_world_part, T_world_tool, float(poses.openings[first]), weightless=True))


def _leaning(point: GraspPoint) -> GraspPoint:
    """The grasp point with an approach up to the horizontal."""
    return point.model_copy(update={"max_tilt_deg": 90.0})
