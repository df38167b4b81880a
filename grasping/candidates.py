"""Estimates times grasp poses, each ruled out with its first reason or ranked."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from pickproof.cell.frames import Array, make_transform
from pickproof.cell.geometry.bin import Bin, Box
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.grippers.parallel_jaw import ParallelJaw
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.grasping.clearance import OpenGripper, covered_share, thin, without_workpiece
from pickproof.grasping.grasp_points import GraspPoint, GraspPoses
from pickproof.grasping.overlap import LIES, overlaps
from pickproof.grasping.ranking import GraspingConfig, robustness
from pickproof.grasping.verdict import VERDICTS, Verdict

NEAR = 0.06  # [m] from a workpiece within which the heap can be in the gripper's way
ROOMY = 0.006  # [m] between the gripper and its neighbours beyond which more is no better
INTRUDERS = 4  # thinned points between the fingers that are as good as another workpiece there
CHUNK = 24
ESTIMATES_ENOUGH = 12
"""Once this many workpieces can be gripped, the less wanted ones are not looked at."""
COVER_COUNTS = 8.0
"""A workpiece of which an eighth lies under others is as bad as one that is buried: it takes them along or jams."""
PER_ESTIMATE = 24
"""Candidates kept of one estimate: the next best of the same workpiece rarely helps where these failed."""


@dataclass(frozen=True)
class GraspCandidate:
    """One way to take one workpiece.

    Attributes:
        estimate: index of the estimate.
        point: the grasp point.
        T_world_tool: (4, 4) TCP at the grasp; T_part_tool: the same in the CAD frame.
        opening: of the jaws on the way in, in [m].
        rank: weighted sum of `terms`, larger is better.
        terms: name -> value in [0, 1], see `grasping.ranking`.
    """

    estimate: int
    point: GraspPoint
    T_world_tool: Array
    T_part_tool: Array
    opening: float
    rank: float
    terms: dict[str, float]


@dataclass(frozen=True)
class Selection:
    """Candidates, best first, and for every estimate how many poses of which grasp were ruled out by what.

    Attributes:
        ruled_out: estimate -> grasp name -> verdict -> count.
        verdicts: estimate -> (n,) verdict on each of the grasp poses, empty for a candidate.
    """

    candidates: list[GraspCandidate]
    ruled_out: dict[int, dict[str, dict[str, int]]] = field(default_factory=dict)
    verdicts: dict[int, np.ndarray] = field(default_factory=dict)


def select(
    Ts_world_part: Array,
    scores: Array,
    avoided: np.ndarray,
    poses: GraspPoses,
    workpiece: Workpiece,
    gripper: Gripper,
    bin: Bin,
    scene_points: Array,
    weights: GraspingConfig,
    errors: Array | None = None,
) -> Selection:
    """Candidates of all estimates, checked for room and ranked.

    Args:
        Ts_world_part: (k, 4, 4) estimated poses; scores: (k,) in [0, 1].
        avoided: (k,) bool: leave this estimate alone (a grasp on it failed lately).
        scene_points: (n, 3) measured points in the world, the bin's own excluded.
        errors: (k,) expected error of each pose in [m], held against the tolerance of each grasp point; None for none.
    """
    scene = thin(scene_points)
    hooked = np.zeros(len(Ts_world_part), dtype=bool)
    if weights.max_overlap_mm2 is not None:
        under = overlaps(workpiece, Ts_world_part, np.asarray(scores) >= LIES)
        hooked = under > 1e-6 * weights.max_overlap_mm2
    heights = Ts_world_part[:, 2, 3] if len(Ts_world_part) else np.zeros(0)
    low, span = heights.min(initial=np.inf), max(float(np.ptp(heights)) if len(heights) else 0.0, 0.01)
    grippers = {float(o): OpenGripper.of(gripper.boxes(float(o))) for o in np.unique(poses.openings)}
    jaw = gripper if isinstance(gripper, ParallelJaw) else None
    betweens = {o: OpenGripper.of([_between(jaw, o)]) for o in grippers} if jaw else {}
    found: list[GraspCandidate] = []
    ruled_out: dict[int, dict[str, dict[str, int]]] = {}
    of_pose: dict[int, np.ndarray] = {}
    tolerances = np.array([poses.points[i].tolerance for i in poses.index])
    wanted = weights.weight_score * np.asarray(scores) + weights.weight_height * (heights - low) / span
    reach = NEAR + float(np.linalg.norm(workpiece.extents)) / 2
    pickable = 0
    for k in np.argsort(-wanted, kind="stable"):
        k, T_world_part = int(k), Ts_world_part[k]
        enough = pickable >= ESTIMATES_ENOUGH
        stop = Verdict.AVOIDED if avoided[k] else Verdict.OUTRANKED
        if scores[k] < weights.min_score:
            stop = Verdict.SCORE
        verdicts = np.full(len(poses.index), stop, dtype=VERDICTS)
        if stop == Verdict.OUTRANKED and not enough:
            error = 0.0 if errors is None else float(errors[k])
            near = np.linalg.norm(scene - T_world_part[:3, 3], axis=1) < reach
            others = without_workpiece(scene[near], T_world_part, workpiece)
            terms = _terms(T_world_part, float(scores[k]), float((heights[k] - low) / span), error, poses)
            free = max(1.0 - COVER_COUNTS * covered_share(workpiece, T_world_part, others), 0.0)
            terms["uncovered"] = np.full(len(poses.index), free)
            Ts, kept = T_world_part @ poses.Ts_part_tool, list[int]()
            verdicts[:] = Verdict.COVERED
            if free >= weights.min_uncovered and not hooked[k]:
                rank = weights.rank(terms)
                kept = _with_room(Ts, rank, tolerances < error, poses, grippers, bin, others, verdicts)
            for i in kept:
                opening, point = float(poses.openings[i]), poses.points[poses.index[i]]
                shape, between = grippers[opening], betweens.get(opening)
                own = {name: float(value[i]) for name, value in terms.items()}
                own["clearance"] = shape.room(Ts[i], others, ROOMY) / ROOMY
                intruders = between.count(Ts[i], others) if between else 0
                own["alone"] = max(1.0 - intruders / INTRUDERS, 0.0)
                total = float(weights.rank(own))
                found.append(GraspCandidate(k, point, Ts[i], poses.Ts_part_tool[i], opening, total, own))
            pickable += bool((verdicts == "").any())
        counts = {name: Counter({str(Verdict.DISABLED): n}) for name, n in poses.disabled.items()}
        for name, n in poses.no_place.items():
            counts.setdefault(name, Counter())[str(Verdict.NO_PLACE)] += n
        for said in np.unique(verdicts[verdicts != ""]):
            of_points = np.bincount(poses.index[verdicts == said], minlength=len(poses.points))
            for point, n in zip(poses.points, of_points.tolist(), strict=True):
                if n:
                    counts.setdefault(point.name, Counter())[str(said)] += n
        ruled_out[k], of_pose[k] = {name: dict(c) for name, c in counts.items()}, verdicts
    found.sort(key=lambda c: -c.rank)
    for candidate in found[weights.max_candidates :]:
        of_point = ruled_out[candidate.estimate].setdefault(candidate.point.name, {})
        of_point[str(Verdict.OUTRANKED)] = of_point.get(str(Verdict.OUTRANKED), 0) + 1
    return Selection(found[: weights.max_candidates], ruled_out, of_pose)


def _terms(T_world_part: Array, score: float, height: float, error: float, poses: GraspPoses) -> dict[str, Array]:
    """Terms (n,) of the ranking that need no look at the heap, for every pose of one estimate."""
    along, limit = tilts(T_world_part @ poses.Ts_part_tool, poses)
    n = len(poses.index)
    return {
        "score": np.full(n, score),
        "height": np.full(n, height),
        "upright": np.clip((along - limit) / np.maximum(1.0 - limit, 1e-9), 0.0, 1.0),
        "priority": np.array([poses.points[i].priority for i in poses.index]),
        "robustness": robustness(poses, error),
    }


def _between(jaw: ParallelJaw, opening: float) -> Box:
    """What the fingers sweep when they close from `opening` [m], in the tool frame."""
    _, width, length = jaw.finger_size
    return Box("between", (opening, width, length), make_transform(t=(0.0, 0.0, -length / 2)))


def tilts(Ts_world_tool: Array, poses: GraspPoses) -> tuple[Array, Array]:
    """Cosine (n,) of the angle between each approach and the one preferred in the world, and the least allowed."""
    wanted = np.array([p.world_approach for p in poses.points])
    wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
    limit = np.cos(np.deg2rad([p.max_tilt_deg for p in poses.points]))
    along = np.einsum("ij,ij->i", Ts_world_tool[:, :3, 2], wanted[poses.index])
    return along, limit[poses.index]


def _with_room(
    Ts: Array,
    rank: Array,
    loose: np.ndarray,
    poses: GraspPoses,
    grippers: dict[float, OpenGripper],
    bin: Bin,
    others: Array,
    verdicts: np.ndarray,
) -> list[int]:
    """Indices of the best PER_ESTIMATE poses with an upright approach and room for the open gripper, best first.

    `loose` (n,) marks poses whose grasp point does not tolerate the error of the estimate. The reason that ruled a
    pose out is written to `verdicts` (n,); the empty string for those returned.
    """
    verdicts[:] = ""
    verdicts[loose] = Verdict.TOLERANCE
    along, limit = tilts(Ts, poses)
    tilted = along < limit - 1e-9
    verdicts[~loose & tilted] = Verdict.TILT
    for opening, shape in grippers.items():
        mine = np.flatnonzero(~loose & ~tilted & (poses.openings == opening))
        verdicts[mine[shape.hits_bin(Ts[mine], bin)]] = Verdict.GRIPPER_BIN
    alive = np.flatnonzero(verdicts == "")
    alive = alive[np.argsort(-rank[alive], kind="stable")]
    kept: list[int] = []
    for start in range(0, len(alive), CHUNK):
        if len(kept) >= PER_ESTIMATE:
            break
        chunk = alive[start : start + CHUNK]
        for opening, shape in grippers.items():
            mine = chunk[poses.openings[chunk] == opening]
            verdicts[mine[shape.hits_points(Ts[mine], others)]] = Verdict.GRIPPER_HEAP
        kept += [int(i) for i in chunk if verdicts[i] == ""]
    verdicts[alive[verdicts[alive] == ""]] = Verdict.OUTRANKED
    kept = kept[:PER_ESTIMATE]
    verdicts[kept] = ""
    return kept
