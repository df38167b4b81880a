"""A grasp tried in the physics and filmed: free on a table in a resting pose, or among neighbours in a small heap."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pickproof.cell.errors import SimulationError
from pickproof.cell.frames import Array, apply, invert
from pickproof.cell.geometry.bin import Bin
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.physics.arm import Arm
from pickproof.cell.physics.bin_filling import fill_bin
from pickproof.cell.physics.observation import Snapshot, observe
from pickproof.cell.physics.world import World
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.grasping.candidates import GraspCandidate, PartEstimates, PickScene, select
from pickproof.grasping.grasp_points import GraspPoint, expand
from pickproof.grasping.ranking import GraspingConfig
from pickproof.scenarios.config.scenario import Scenario
from pickproof.scenarios.grasp_trials.check import best_candidate
from pickproof.scenarios.grasp_trials.trial import TrialCell
from pickproof.scenarios.picking.grasp_oracle import GraspOracle

PERIOD = 0.02  # [s] between two frames
NEIGHBOURS = 12  # workpieces in the heap
FILLS = 5
HEAP_SAMPLES = 3000  # of the surface of each neighbour
STILL = 2e-4  # [m] motion of the tool from which the lift has begun


@dataclass(frozen=True)
class Film:
    """The recorded motion, frame by frame.

    Attributes:
        time: (n,) [s]; Ts_world_tool: (n, 4, 4); openings: (n,) [m]; Ts_world_part: (n, k, 4, 4).
    """

    time: Array
    Ts_world_tool: Array
    openings: Array
    Ts_world_part: Array

    def slip(self, part: int, com: Array) -> float:
        """[m] motion of a workpiece's centre of mass in the gripper from the start of the lift to the end."""
        low = int(np.argmin(self.Ts_world_tool[:, 2, 3]))
        moved = np.linalg.norm(self.Ts_world_tool[low:, :3, 3] - self.Ts_world_tool[low, :3, 3], axis=1) > STILL
        start = low + max(int(np.argmax(moved)) - 1, 0)
        in_hand = apply(invert(self.Ts_world_tool[[start, -1]]) @ self.Ts_world_part[[start, -1], part], com[None])
        return float(np.linalg.norm(in_hand[1] - in_hand[0]))


@dataclass(frozen=True)
class Outcome:
    """Result of one trial: whether the grasp held, else why not; no film where the gripper cannot reach the grasp.

    Attributes:
        slip: [m] motion of the held workpiece in the gripper.
        part: which workpiece of the film it was.
        bin: of the heap, None for the table.
    """

    held: bool
    reason: str
    slip: float = 0.0
    film: Film | None = None
    part: int = 0
    bin: Bin | None = None


def record(world: World, arm: Arm, run: Callable[[], object]) -> Film:
    """Record all motion while `run` runs."""
    frames: list[tuple[Array, float, Array]] = []
    steps = [0]
    every = max(round(PERIOD / world.dt), 1)

    def watch() -> None:
        if steps[0] % every == 0:
            frames.append((arm.tool_pose(), arm.opening, world.part_poses()))
        steps[0] += 1

    world.after_step.append(watch)
    try:
        run()
    finally:
        world.after_step.remove(watch)
    frames.append((arm.tool_pose(), arm.opening, world.part_poses()))
    tools, openings, parts = zip(*frames, strict=True)
    return Film(PERIOD * np.arange(len(frames), dtype=np.float64), np.stack(tools), np.array(openings), np.stack(parts))


def try_free(cell: TrialCell, T_world_part: Array, point: GraspPoint) -> Outcome:
    """Try a grasp on a single workpiece on a table at T_world_part: grip, lift, shake."""
    best = best_candidate(point.model_copy(update={"enabled": True}), T_world_part, cell.workpiece, cell.gripper)
    if isinstance(best, str):
        return Outcome(False, best)
    trials = []
    cell.world.place_part(0, T_world_part)
    film = record(
        cell.world, cell.arm, lambda: trials.append(cell.try_grasp(T_world_part, best.T_world_tool, best.opening))
    )
    trial = trials[0]
    return Outcome(trial.held, trial.reason, trial.slip, film)


class HeapCell:
    """A small settled heap in which grasps are tried; the workpieces go back to their places before each try."""

    def __init__(self, workpiece: Workpiece, gripper: Gripper, seed: int = 0) -> None:
        self.workpiece, self.gripper = workpiece, gripper
        self.bin = small_bin(workpiece)
        self.truth: Snapshot = _settled(workpiece, self.bin, seed)
        scenario = Scenario(name="heap", workpiece=workpiece.name)
        self._grasp_oracle = GraspOracle(scenario, workpiece, gripper, self.bin, self.bin.boxes())
        self._grasp_oracle.put_back(self.truth)
        points = workpiece.sample_surface(HEAP_SAMPLES, seed=3)[0]
        self._clouds = apply(self.truth.Ts_world_part, points)

    def close(self) -> None:
        """Close the physics."""
        self._grasp_oracle.close()

    def try_grasp(self, point: GraspPoint) -> Outcome:
        """The grasp on that workpiece of the heap on which it ranks best."""
        best = self._best(point)
        if isinstance(best, str):
            return Outcome(False, best, bin=self.bin)
        reasons: list[str] = []
        grasp_oracle = self._grasp_oracle
        film = record(
            grasp_oracle.world, grasp_oracle.arm, lambda: reasons.append(grasp_oracle.refuses(best, self.truth))
        )
        held = reasons[0] == ""
        part = best.estimate
        slip = film.slip(part, self.workpiece.com) if held else 0.0
        return Outcome(held, reasons[0], slip, film, part, self.bin)

    def _best(self, point: GraspPoint) -> GraspCandidate | str:
        """The best candidate of all workpieces in the heap, or what rules most of the poses out."""
        inside = self.truth.parts_in(self.bin.name)
        poses = expand((point.model_copy(update={"enabled": True}),), self.workpiece)
        found: list[GraspCandidate] = []
        counts: dict[str, int] = {}
        for k in inside:
            T = self.truth.Ts_world_part[k]
            others = self._clouds[[i for i in inside if i != k]].reshape(-1, 3)
            scene = PickScene(self.workpiece, self.gripper, self.bin, others)
            one = select(PartEstimates(T[None], np.ones(1)), poses, scene, GraspingConfig())
            height = float(T[2, 3] - self.truth.Ts_world_part[list(inside), 2, 3].min())
            found += [_of(c, k, height) for c in one.candidates[:1]]
            for verdict, n in one.ruled_out[0].get(point.name, {}).items():
                counts[verdict] = counts.get(verdict, 0) + n
        if found:
            return max(found, key=lambda c: c.rank)
        most, all_poses = sorted(counts, key=lambda verdict: -counts[verdict]), sum(counts.values())
        shares = [f"{verdict} {100 * counts[verdict] / all_poses:.0f} %" for verdict in most[:2]]
        return ", ".join(shares) or "no workpiece in the heap"


def small_bin(workpiece: Workpiece) -> Bin:
    """A bin as full as in training, with walls of half height, because they are closer than in a real one."""
    heap, few = workpiece.heap, NEIGHBOURS / max(workpiece.heap.count[1], NEIGHBOURS)
    longest = 1.15 * float(np.linalg.norm(workpiece.extents))
    x, y, z = heap.bin_inner
    shrink = np.sqrt(few)
    size = (float(max(x * shrink, min(longest, x))), float(max(y * shrink, min(longest, y))), z / 2)
    return Bin("bin", size, 0.005, (0.0, 0.0, 0.01))


def _settled(workpiece: Workpiece, bin: Bin, seed: int) -> Snapshot:
    """A heap at rest; a fill that does not come to rest is discarded, as in an episode.

    Raises:
        SimulationError: none of FILLS fills comes to rest.
    """
    for k in range(FILLS):
        world = World()
        try:
            for box in bin.boxes():
                world.add_box(box)
            fill_bin(world, workpiece, bin, NEIGHBOURS, np.random.default_rng((seed, k)))
            return observe(world, [bin])
        except SimulationError:
            if k == FILLS - 1:
                raise
        finally:
            world.close()
    raise AssertionError


def _of(candidate: GraspCandidate, part: int, height: float) -> GraspCandidate:
    """A candidate of one workpiece as one of the heap, the higher the better."""
    return replace(candidate, estimate=part, rank=candidate.rank + height / 0.05)
