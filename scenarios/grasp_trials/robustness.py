"""Pose errors that each grasp tolerates, by direction, compared with the errors of perception."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array, about_axis, make_transform
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.grasping.candidates import GraspCandidate
from pickproof.grasping.grasp_points import GraspPoint
from pickproof.scenarios.grasp_trials.check import best_candidate, lying
from pickproof.scenarios.grasp_trials.trial import PlacedGrasp, TrialCell, try_errors

AXES = ("x", "y", "z", "rx", "ry", "rz")
"""Directions of an error: along and about the axes of the CAD, through the centre of mass."""
KEYS = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")  # in `axis_errors` of evaluation.json
SIZES = {"mm": (0.5, 1.0, 2.0, 3.0, 4.0, 6.0), "deg": (1.0, 2.0, 4.0, 7.0, 10.0, 15.0)}
TOOL_AXES = ("closing", "across", "approach")  # meaning of x, y and z of the tool


@dataclass(frozen=True)
class Robustness:
    """The pose errors that one grasp tolerates.

    Attributes:
        resting: index of the resting pose that it was tried in, likeliest first; -1 where the gripper has no room.
        reason: why it does not hold even without an error; empty where it does.
        held: (6, 2 s + 1) bool over AXES and sizes, from the largest negative one over none to the largest positive.
        reasons: what happened at the smallest error that it does not tolerate, of each of AXES; empty for none.
        along: which axis of the tool each of AXES is nearest to.
    """

    grasp: str
    resting: int
    reason: str
    held: np.ndarray
    reasons: tuple[str, ...]
    along: tuple[str, ...]

    @property
    def tolerated(self) -> Array:
        """(6, 2) in [mm] and [deg]: the largest error, negative and positive, up to which the grasp always held."""
        middle = self.held.shape[1] // 2
        found = np.zeros((len(AXES), 2))
        for a in range(len(AXES)):
            for side, way in enumerate((self.held[a, middle::-1], self.held[a, middle:])):
                steps = len(way) if way.all() else int(np.argmin(way))
                found[a, side] = 0.0 if steps < 2 else sizes_of(a)[steps - 2]
        return found

    @property
    def share(self) -> float:
        """Share of the tried errors under which it held."""
        return float(self.held.mean())


@dataclass(frozen=True)
class Task:
    """One grasp to be tried; sent to worker processes."""

    workpiece: str
    gripper: str
    point: GraspPoint


def sizes_of(axis: int) -> tuple[float, ...]:
    """Sizes of errors tried along ([mm]) or about ([deg]) one of AXES."""
    return SIZES["mm"] if axis < 3 else SIZES["deg"]


def axis_error(axis: int, size: float) -> Array:
    """T_part_estimate (4, 4) that is off by `size` [mm] along, or [deg] about, one of AXES."""
    unit = np.eye(3)[axis % 3]
    return make_transform(t=1e-3 * size * unit) if axis < 3 else about_axis(unit, np.array(np.deg2rad(size)))


def try_robustness(task: Task) -> Robustness:
    """Try one grasp under every error, in the likeliest resting pose that leaves the gripper room."""
    workpiece, gripper = load_workpiece(task.workpiece), load_gripper(task.gripper)
    with closing(TrialCell(workpiece, gripper)) as cell:
        resting = cell.resting_poses()
        cell.rebuild()
        for k, (best, *_) in lying(task.point, resting, workpiece, gripper):
            return _measured(cell, k, resting[k], best)
        verdict = best_candidate(task.point, resting[0], workpiece, gripper)
    never = np.zeros((len(AXES), 2 * len(SIZES["mm"]) + 1), dtype=bool)
    return Robustness(task.point.name, -1, str(verdict), never, ("",) * len(AXES), ("",) * len(AXES))


def _measured(cell: TrialCell, index: int, T_world_part: Array, grasp: GraspCandidate) -> Robustness:
    """A grasp under every error on a workpiece in the resting pose of this index."""
    placed = PlacedGrasp(T_world_part, grasp.T_world_tool, grasp.opening)
    rows, reasons = [], []
    for a in range(len(AXES)):
        steps = [-s for s in reversed(sizes_of(a))] + [0.0, *sizes_of(a)]
        trials = list(try_errors(cell, placed, np.stack([axis_error(a, s) for s in steps])))
        rows.append([t.held for t in trials])
        lost = sorted((abs(s), t.reason) for s, t in zip(steps, trials, strict=True) if not t.held)
        reasons.append(lost[0][1] if lost else "")
    held = np.array(rows)
    reason = "" if held[:, held.shape[1] // 2].all() else next(r for r in reasons if r)
    nearest = np.abs(grasp.T_part_tool[:3, :3]).argmax(1)
    along = tuple(TOOL_AXES[nearest[a % 3]] for a in range(len(AXES)))
    return Robustness(grasp.point.name, index, reason, held, tuple(reasons), along)


def read_errors(path: Path) -> dict[str, float]:
    """Errors in [mm] and [deg], by KEYS, that 95 % of the right poses of `pickproof evaluate` stay under.

    Raises:
        InputError: no evaluation.json, or one without `axis_errors`.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        return {key: float(data["axis_errors"][key]["p95"]) for key in KEYS}
    except FileNotFoundError:
        raise InputError(path, "", "missing file", "the evaluation.json of `pickproof evaluate`") from None
    except (OSError, ValueError, KeyError, TypeError):
        valid = f"the errors of {', '.join(KEYS)}, as `pickproof evaluate` writes them"
        raise InputError(path, "axis_errors", "nothing that can be read", valid) from None


def beyond(grasp: Robustness, errors: dict[str, float]) -> list[int]:
    """Indices of AXES along which perception's error exceeds the tolerance in either direction; worst first."""
    least = grasp.tolerated.min(1)
    excess = {a: errors[KEYS[a]] - least[a] for a in range(len(AXES)) if errors[KEYS[a]] > least[a]}
    scale = np.array([sizes_of(a)[-1] for a in range(len(AXES))])
    return sorted(excess, key=lambda a: -excess[a] / scale[a])


def verdict(grasp: Robustness, errors: dict[str, float] | None) -> str:
    """One line: whether the grasp will fail, in which direction, and the failure."""
    if grasp.resting < 0:
        return f"not tried: the gripper has no clearance in any resting pose ({grasp.reason})"
    if grasp.reason:
        return f"fails without any error: {grasp.reason}"
    if errors is None:
        worst = int(np.argmin(grasp.tolerated.min(1) / [sizes_of(a)[-1] for a in range(len(AXES))]))
        if not grasp.reasons[worst]:
            return "tolerates every error that was tried"
        size = _size(worst, grasp.tolerated[worst].min())
        return f"tolerates least {_along(grasp, worst)}, {size}; then: {grasp.reasons[worst]}"
    found = beyond(grasp, errors)
    if not found:
        return "tolerates the errors of perception"
    a = found[0]
    others = f", and {', '.join(AXES[b] for b in found[1:])}" if found[1:] else ""
    return (
        f"will fail: perception has errors up to {_size(a, errors[KEYS[a]])} {_along(grasp, a)}, the grasp tolerates "
        f"{_size(a, grasp.tolerated[a].min())}; then: {grasp.reasons[a]}{others}"
    )


def _along(grasp: Robustness, axis: int) -> str:
    return f"{'along' if axis < 3 else 'about'} {AXES[axis][-1]} ({grasp.along[axis]})"


def _size(axis: int, size: float) -> str:
    return f"{size:.3g} {'mm' if axis < 3 else 'deg'}"


def document(grasps: Sequence[Robustness], errors: dict[str, float] | None) -> dict[str, Any]:
    """What robustness.json holds."""
    return {
        "axes": list(KEYS),
        "sizes": {key: list(sizes) for key, sizes in SIZES.items()},
        "perception_p95": errors,
        "grasps": [
            {
                "grasp": g.grasp,
                "resting": g.resting,
                "tolerated": {key: g.tolerated[a].tolist() for a, key in enumerate(KEYS)},
                "held": g.held.tolist(),
                "share": g.share,
                "verdict": verdict(g, errors),
            }
            for g in grasps
        ],
    }


def named(points: Iterable[GraspPoint], names: str | None, file: Path | str) -> list[GraspPoint]:
    """Of the grasp points those in the comma-separated `names`; all for `all` or None.

    Raises:
        InputError: there is no grasp point of a name.
    """
    found = {p.name: p for p in points}
    if names in (None, "all"):
        return list(found.values())
    wanted = [n.strip() for n in str(names).split(",")]
    for name in wanted:
        if name not in found:
            raise InputError("command line", "--grasps", name, f"all, or of {file}: {', '.join(found)}")
    return [found[name] for name in dict.fromkeys(wanted)]
