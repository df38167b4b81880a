"""From estimated poses to ranked candidates: collision-free grasps of every estimate.

The weights of the rank are in `grasping/ranking.py`, its terms in `grasping/estimate_checks.py`; this adds the term of
motion time.
"""

from __future__ import annotations

from pickproof.cell.sensing.camera import DepthFrame
from pickproof.grasping.candidates import PartEstimates, PickScene, Selection, select
from pickproof.grasping.grasp_points import GraspPoses
from pickproof.scenarios.picking.episode_state import EpisodeState
from pickproof.scenarios.picking.motion_time import with_motion
from pickproof.scenarios.picking.stages import Estimates
from pickproof.scenarios.picking.workcell import Workcell


def choose(cell: Workcell, frame: DepthFrame, estimates: Estimates, state: EpisodeState, attempt: int) -> Selection:
    """All pairs of estimate and grasp pose, checked and ranked; grasps without a place only where no other is free.

    The latter are refused in planning, which reports that a regrasp is needed.
    """
    can = state.placeable(cell.grasps)
    selection = _choose(cell, frame, estimates, state, attempt, cell.grasps.placeable(can))
    if not selection.candidates and not can.all():
        selection = _choose(cell, frame, estimates, state, attempt, cell.grasps)
    return selection


def _choose(
    cell: Workcell, frame: DepthFrame, estimates: Estimates, state: EpisodeState, attempt: int, grasps: GraspPoses
) -> Selection:
    weights = cell.scenario.grasping
    avoided = state.avoided(estimates.Ts_world_part, attempt, cell.scenario.stop.attempts_to_avoid)
    found = PartEstimates(estimates.Ts_world_part, estimates.scores, avoided, estimates.residuals)
    scene = PickScene(cell.workpiece, cell.gripper, cell.source, cell.heap.points(cell, frame, estimates))
    selection = select(found, grasps, scene, weights)
    start = cell.carrier.ranking_start(cell, state)
    return with_motion(selection, cell.robot, start, cell.gripper.T_flange_tool, weights)
