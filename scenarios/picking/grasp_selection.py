"""From estimated poses to ranked candidates: grasp points on every estimate, with room and with a way for the arm."""

from __future__ import annotations

import numpy as np

from pickproof.cell.frames import Array, apply
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.grasping.candidates import Selection, select
from pickproof.grasping.grasp_points import GraspPoses
from pickproof.scenarios.picking.episode_state import EpisodeState, waits_at
from pickproof.scenarios.picking.heap_heightmap import scene_points, true_points
from pickproof.scenarios.picking.motion_time import with_motion
from pickproof.scenarios.picking.stages import Estimates
from pickproof.scenarios.picking.workcell import Workcell

KNOWN_SCORE = 0.7
"""Estimates from this score on count as bodies for the gripper, by points of their surface."""
KNOWN_SPACING, KNOWN_SAMPLES = 0.006, (800, 12_000)  # [m] between such points, and how many there are of one body


def choose(cell: Workcell, frame: DepthFrame, estimates: Estimates, state: EpisodeState, attempt: int) -> Selection:
    """Estimates times grasp points, checked for room and ranked; those without a place only where nothing else is free.

    The latter are refused when a plan is asked for, which tells that a regrasp would be needed.
    """
    can = state.placeable(cell.grasps)
    selection = _choose(cell, frame, estimates, state, attempt, cell.grasps.placeable(can))
    if not selection.candidates and not can.all():
        selection = _choose(cell, frame, estimates, state, attempt, cell.grasps)
    return selection


def _choose(
    cell: Workcell, frame: DepthFrame, estimates: Estimates, state: EpisodeState, attempt: int, grasps: GraspPoses
) -> Selection:
    span = cell.scenario.stop.attempts_to_avoid
    selection = select(
        estimates.Ts_world_part,
        estimates.scores,
        state.avoided(estimates.Ts_world_part, attempt, span),
        grasps,
        cell.workpiece,
        cell.gripper,
        cell.source,
        true_points(cell) if "grasp" in cell.oracle else heap_points(cell, frame, estimates),
        cell.scenario.grasping,
        estimates.residuals,
    )
    start = (
        cell.robot.home if "motion" in cell.oracle else waits_at(cell, state)
    )  # joints of the arm, not a floating gripper's
    return with_motion(selection, cell.robot, start, cell.gripper.T_flange_tool, cell.scenario.grasping)


def heap_points(cell: Workcell, frame: DepthFrame, estimates: Estimates) -> Array:
    """Points (n, 3) in the world that the gripper keeps off: measured ones, and on the hidden sides of workpieces.

    A workpiece whose pose is believed is known all round; a finger that leans would else land on what it hides.
    """
    known = estimates.Ts_world_part[estimates.scores >= KNOWN_SCORE]
    samples = int(np.clip(cell.workpiece.mesh.area / KNOWN_SPACING**2, *KNOWN_SAMPLES))
    surface = cell.workpiece.sample_surface(samples, seed=8)[0]
    hidden = apply(known, surface).reshape(-1, 3)
    return np.concatenate([scene_points(cell, frame), hidden])
