"""Joint paths between two configurations: straight, over a via point, and only then searched (OMPL RRT-Connect)."""

from __future__ import annotations

from typing import Literal

import numpy as np
from ompl import base, geometric
from ompl import util as ompl_util

from pickproof.cell.frames import Array
from pickproof.robots.collision.scene import CollisionScene
from pickproof.robots.kinematics.inverse import SIGMA_MIN, branch, inverse
from pickproof.robots.kinematics.model import forward

Method = Literal["direct", "via", "search"]

RAISE = (0.10, 0.20)  # [m] heights of via points above the ends
MAX_CHECKS = 12_000  # largest number of checked configurations; a count, not a time, keeps plans repeatable
SHORTCUTS = 40
_WINDOW = np.array([0.8, 1.0, 1.2, 1.0, 0.9, 1.0])  # [rad] margin of the search around the box spanned by both ends

ompl_util.setLogLevel(ompl_util.LogLevel.LOG_NONE)


def connect_quickly(scene: CollisionScene, q0: Array, q1: Array) -> tuple[Array, Method] | None:
    """Collision-free waypoints (n, 6) from q0 to q1 (6,), straight or over a via point above either end."""
    if scene.free_path(np.stack([q0, q1])):
        return np.stack([q0, q1]), "direct"
    for height in RAISE:
        above0, above1 = _raised(scene, q0, height), _raised(scene, q1, height)
        for via in ([above0, above1], [above1], [above0]):
            if all(v is not None for v in via):
                waypoints = np.stack([q0, *(v for v in via if v is not None), q1])
                if scene.free_path(waypoints):
                    return waypoints, "via"
    return None


def search(scene: CollisionScene, q0: Array, q1: Array, seed: int) -> Array | None:
    """Collision-free waypoints (n, 6) from q0 to q1 by RRT-Connect and shortcuts, or None within MAX_CHECKS.

    `RNG.setSeed` before each search restarts OMPL's seed sequence, and the search ends after a count of checks. So the
    same call gives the same path, whatever ran before in the process (tested).
    """
    # The tree is checked coarsely and the found path finely; if that fails, the search runs again with a fine tree.
    for step in (0.03, 0.008):
        path = _rrt_connect(scene, q0, q1, seed, step)
        if path is not None and scene.free_path(path):
            return _prune(scene, _shortcut(scene, _prune(scene, path), np.random.default_rng(seed)))
    return None


def _rrt_connect(scene: CollisionScene, q0: Array, q1: Array, seed: int, step: float) -> Array | None:
    if not (scene.free(q0) and scene.free(q1)):
        return None
    robot = scene.robot
    low = np.maximum(np.minimum(q0, q1) - _WINDOW, robot.lower)
    high = np.minimum(np.maximum(q0, q1) + _WINDOW, robot.upper)
    shoulder = int(branch(robot, q0)) & 2
    checks = 0

    def valid(state: base.State) -> bool:
        nonlocal checks
        checks += 1
        q = np.array([state[i] for i in range(6)])
        return scene.free(q) and int(branch(robot, q)) & 2 == shoulder

    ompl_util.RNG.setSeed(seed % (2**31 - 2) + 1)
    space = base.RealVectorStateSpace(6)
    bounds = base.RealVectorBounds(6)
    for i in range(6):
        bounds.setLow(i, float(low[i]))
        bounds.setHigh(i, float(high[i]))
    space.setBounds(bounds)
    setup = geometric.SimpleSetup(space)
    setup.setStateValidityChecker(valid)
    start, goal = space.allocState(), space.allocState()
    for i in range(6):
        start[i], goal[i] = float(q0[i]), float(q1[i])
    setup.setStartAndGoalStates(start, goal)
    information = setup.getSpaceInformation()
    information.setStateValidityCheckingResolution(step / space.getMaximumExtent())
    planner = geometric.RRTConnect(information)
    planner.setRange(0.6)
    setup.setPlanner(planner)
    setup.solve(base.PlannerTerminationCondition(lambda: checks > MAX_CHECKS))
    if not setup.haveExactSolutionPath():
        return None
    found = setup.getSolutionPath()
    return np.array([[found.getState(k)[i] for i in range(6)] for k in range(found.getStateCount())])


def _shortcut(scene: CollisionScene, path: Array, rng: np.random.Generator) -> Array:
    """Replace sections between two random points of the path by straight lines where these are free."""
    for _ in range(SHORTCUTS):
        if len(path) == 2:
            break
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
        a, b = np.sort(rng.uniform(0.0, s[-1], 2))
        if rng.uniform() < 0.3:  # ends matter most
            a, b = (0.0, b) if rng.uniform() < 0.5 else (a, s[-1])
        before, after = np.searchsorted(s, a, side="right"), np.searchsorted(s, b, side="left")
        if after <= before:
            continue
        ends = np.stack([[np.interp(x, s, path[:, j]) for j in range(6)] for x in (a, b)])
        if scene.free_path(ends):
            path = np.concatenate([path[:before], ends, path[after:]])
            path = path[np.concatenate([[True], np.abs(np.diff(path, axis=0)).max(axis=1) > 1e-9])]
    return path


def _prune(scene: CollisionScene, path: Array) -> Array:
    """Remove waypoints that a straight line can replace, longest lines first."""
    kept, i = [path[0]], 0
    while i < len(path) - 1:
        i = next(j for j in range(len(path) - 1, i, -1) if j == i + 1 or scene.free_path(path[[i, j]]))
        kept.append(path[i])
    return np.stack(kept)


def _raised(scene: CollisionScene, q: Array, height: float) -> Array | None:
    """The same flange pose `height` [m] higher, in the same branch, clear of limits and singularities."""
    T = forward(scene.robot, q)
    T[2, 3] += height
    found = inverse(scene.robot, T[None], q)
    slot = int(branch(scene.robot, q))
    usable = found.valid[0, slot] and found.sigma[0, slot] > SIGMA_MIN
    return found.q[0, slot] if usable else None
