"""Checks of the grasp poses of one estimate: each gets the first reason that rules it out, or its rank terms.

The checks run in the order of `grasping.verdict`: cover of the workpiece, tolerance of the grasp point, tilt of the
approach, clearance in the bin, clearance in the heap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pickproof.cell.frames import Array, make_transform
from pickproof.cell.geometry.bin import Bin, Box
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.grippers.parallel_jaw import ParallelJaw
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.grasping.clearance import OpenGripper, covered_share, without_workpiece
from pickproof.grasping.grasp_points import GraspPoses
from pickproof.grasping.ranking import GraspingConfig, robustness
from pickproof.grasping.verdict import VERDICTS, Verdict

NEAR = 0.06  # [m] distance from a workpiece within which the heap can collide with the gripper
ROOMY = 0.006  # [m] clearance to neighbours from which the term is 1
INTRUDERS = 4  # thinned points between the fingers that count as another workpiece
CHUNK = 24  # poses that are checked against the heap at a time
COVER_COUNTS = 8.0
"""Factor on the covered share: at a share of 1/8 the term is 0, since such a workpiece lifts others or jams."""
PER_ESTIMATE = 24
"""Candidates kept per estimate: further ones of the same workpiece rarely succeed where these fail."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """One estimated workpiece.

    Attributes:
        T_world_part: (4, 4); score: in [0, 1].
        height: in [0, 1] from the lowest to the highest estimate.
        error: expected error of the pose in [m].
        hooked: too much of it lies under another estimate with a sufficient score.
    """

    T_world_part: Array
    score: float
    height: float
    error: float
    hooked: bool


@dataclass(frozen=True, eq=False)
class Checked:
    """The grasp poses of one estimate after the checks.

    Attributes:
        verdicts: (n,) the first reason that rules a pose out; the empty string for those kept.
        kept: indices of the kept poses, best first; Ts_world_tool: (len(kept), 4, 4) their TCP.
        terms: of the rank, name -> value in [0, 1], one mapping for each kept pose.
    """

    verdicts: np.ndarray
    kept: list[int]
    Ts_world_tool: Array
    terms: list[dict[str, float]]


@dataclass(frozen=True, eq=False)
class EstimateChecks:
    """The data against which every estimate of a frame is checked; built once per frame by `of`.

    Attributes:
        poses: n grasp poses in the CAD frame. workpiece, bin, weights: as given to `select`.
        scene: (m, 3) thinned points in the world.
        grippers: opening [m] -> the open gripper; swept: opening -> volume swept by its closing jaws, empty for
            grippers without jaws.
        tolerances: (n,) [m] error of the estimate that each pose tolerates.
    """

    poses: GraspPoses
    workpiece: Workpiece
    bin: Bin
    weights: GraspingConfig
    scene: Array
    grippers: dict[float, OpenGripper]
    swept: dict[float, OpenGripper]
    tolerances: Array

    @staticmethod
    def of(
        poses: GraspPoses, workpiece: Workpiece, gripper: Gripper, bin: Bin, scene: Array, weights: GraspingConfig
    ) -> EstimateChecks:
        """Checks of one frame; `scene` (m, 3) thinned points in the world."""
        grippers = {float(o): OpenGripper.of(gripper.boxes(float(o))) for o in np.unique(poses.openings)}
        jaw = gripper if isinstance(gripper, ParallelJaw) else None
        swept = {o: OpenGripper.of([_between(jaw, o)]) for o in grippers} if jaw else {}
        tolerances = np.array([poses.points[i].tolerance for i in poses.index])
        return EstimateChecks(poses, workpiece, bin, weights, scene, grippers, swept, tolerances)

    def all_ruled_out(self, verdict: Verdict) -> Checked:
        """Checks in which one reason rules out all poses of an estimate."""
        return Checked(np.full(len(self.poses.index), verdict, dtype=VERDICTS), [], np.zeros((0, 4, 4)), [])

    def check(self, estimate: Estimate) -> Checked:
        """Check the poses of one estimate for cover, tolerance, tilt and clearance."""
        others = self._others(estimate.T_world_part)
        covered = covered_share(self.workpiece, estimate.T_world_part, others)
        uncovered = max(1.0 - COVER_COUNTS * covered, 0.0)
        if uncovered < self.weights.min_uncovered or estimate.hooked:
            return self.all_ruled_out(Verdict.COVERED)
        Ts_world_tool = estimate.T_world_part @ self.poses.Ts_part_tool
        terms = self._terms(estimate, Ts_world_tool, uncovered)
        loose = self.tolerances < estimate.error
        verdicts, kept = self._with_room(Ts_world_tool, self.weights.rank(terms), loose, others)
        own = [self._terms_of(i, terms, Ts_world_tool[i], others) for i in kept]
        return Checked(verdicts, kept, Ts_world_tool[kept], own)

    def _others(self, T_world_part: Array) -> Array:
        """Points (m, 3) of the heap near a workpiece, without those of the workpiece."""
        reach = NEAR + float(np.linalg.norm(self.workpiece.extents)) / 2
        near = np.linalg.norm(self.scene - T_world_part[:3, 3], axis=1) < reach
        return without_workpiece(self.scene[near], T_world_part, self.workpiece)

    def _terms(self, estimate: Estimate, Ts_world_tool: Array, uncovered: float) -> dict[str, Array]:
        """Terms (n,) of the rank that do not depend on the gripper's clearance in the heap."""
        along, limit = tilts(Ts_world_tool, self.poses)
        n = len(self.poses.index)
        return {
            "score": np.full(n, estimate.score),
            "height": np.full(n, estimate.height),
            "upright": np.clip((along - limit) / np.maximum(1.0 - limit, 1e-9), 0.0, 1.0),
            "priority": np.array([self.poses.points[i].priority for i in self.poses.index]),
            "robustness": robustness(self.poses, estimate.error),
            "uncovered": np.full(n, uncovered),
        }

    def _terms_of(self, i: int, terms: dict[str, Array], T_world_tool: Array, others: Array) -> dict[str, float]:
        """All terms of pose i, including those computed from the heap: `clearance` and `alone`."""
        opening = float(self.poses.openings[i])
        own = {name: float(value[i]) for name, value in terms.items()}
        own["clearance"] = self.grippers[opening].room(T_world_tool, others, ROOMY) / ROOMY
        swept = self.swept.get(opening)
        intruders = swept.count(T_world_tool, others) if swept else 0
        own["alone"] = max(1.0 - intruders / INTRUDERS, 0.0)
        return own

    def _with_room(
        self, Ts_world_tool: Array, rank: Array, loose: np.ndarray, others: Array
    ) -> tuple[np.ndarray, list[int]]:
        """Verdicts (n,), and the best PER_ESTIMATE poses with an allowed approach and enough clearance, best first.

        `loose` (n,) marks poses whose grasp point does not tolerate the error of the estimate.
        """
        poses = self.poses
        verdicts = np.full(len(poses.index), "", dtype=VERDICTS)
        verdicts[loose] = Verdict.TOLERANCE
        along, limit = tilts(Ts_world_tool, poses)
        tilted = along < limit - 1e-9
        verdicts[~loose & tilted] = Verdict.TILT
        for opening, shape in self.grippers.items():
            mine = np.flatnonzero(~loose & ~tilted & (poses.openings == opening))
            verdicts[mine[shape.hits_bin(Ts_world_tool[mine], self.bin)]] = Verdict.GRIPPER_BIN
        alive = np.flatnonzero(verdicts == "")
        alive = alive[np.argsort(-rank[alive], kind="stable")]
        kept: list[int] = []
        for start in range(0, len(alive), CHUNK):
            if len(kept) >= PER_ESTIMATE:
                break
            chunk = alive[start : start + CHUNK]
            for opening, shape in self.grippers.items():
                mine = chunk[poses.openings[chunk] == opening]
                verdicts[mine[shape.hits_points(Ts_world_tool[mine], others)]] = Verdict.GRIPPER_HEAP
            kept += [int(i) for i in chunk if verdicts[i] == ""]
        verdicts[alive[verdicts[alive] == ""]] = Verdict.OUTRANKED
        kept = kept[:PER_ESTIMATE]
        verdicts[kept] = ""
        return verdicts, kept


def tilts(Ts_world_tool: Array, poses: GraspPoses) -> tuple[Array, Array]:
    """Cosine (n,) of the angle between each approach and the preferred one in the world, and its lower limit."""
    wanted = np.array([p.world_approach for p in poses.points])
    wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
    limit = np.cos(np.deg2rad([p.max_tilt_deg for p in poses.points]))
    along = np.einsum("ij,ij->i", Ts_world_tool[:, :3, 2], wanted[poses.index])
    return along, limit[poses.index]


def _between(jaw: ParallelJaw, opening: float) -> Box:
    """The volume swept by the fingers when they close from `opening` [m], in the tool frame."""
    _, width, length = jaw.finger_size
    return Box("between", (opening, width, length), make_transform(t=(0.0, 0.0, -length / 2)))
