"""The stops of the arm during a pick, each with the straight tool line that leads away from it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pickproof.cell.frames import Array
from pickproof.robots.collision.checker import Mode
from pickproof.robots.collision.scene import CollisionScene
from pickproof.robots.failure import PlanFailure, Refusal, Stage
from pickproof.robots.kinematics.inverse import flange_poses
from pickproof.robots.motion.stop import Line, Stop
from pickproof.robots.motion.timing import JointPath
from pickproof.robots.plan.pick_request import PickRequest

UP = np.array([0.0, 0.0, 1.0])


def lift_stop(scene: CollisionScene, request: PickRequest, grasp: Array, q: Array) -> Stop | PlanFailure:
    """The grasp with the line away from it, which continues until the part is out of the bin if the arm can follow
    it.
    """
    way = np.array(request.lines.retract_direction)
    if request.lines.out_of_bin > request.lines.retract:
        line = Line(scene.robot, grasp, q, request.lines.out_of_bin * way)
        if isinstance(line.path, JointPath):
            return Stop(q, line, "contact", request.lines.straight or request.lines.retract)
    way = request.lines.retract * way
    return stop_with_line(scene, request, grasp, q, way, "contact", Stage.LIFT_LINE, "lift line")


def start_stop(scene: CollisionScene, request: PickRequest) -> Stop | PlanFailure:
    """The current stop of the arm, with the line away from it."""
    if not request.lines.depart:
        return Stop(request.q_start)
    T = flange_poses(scene.robot, request.q_start[None])[0]
    rise, what = request.lines.depart * UP, "line from the start"
    stop = stop_with_line(scene, request, T, request.q_start, rise, "depart", Stage.APPROACH, what)
    if isinstance(stop, PlanFailure):
        return stop
    if stop.line is not None and isinstance(stop.line.path, JointPath):
        ways = stop.line.path.spline(np.linspace(0.0, 1.0, 9))
        touched = next((c for q in ways if (c := scene.first_contact(q, "depart"))), None)
        if touched is not None and touched[1] == "placed":  # the arm is already there; straight up is the only way out
            scene.stands_among_placed()
    return replace(stop, narrowing=request.hand.narrowing)


def stop_with_line(
    scene: CollisionScene, request: PickRequest, T: Array, q: Array, way: Array, mode: Mode, stage: Stage, what: str
) -> Stop | PlanFailure:
    """A stop at flange pose T with a line by `way` (3,) in the world; at least its beginning is reachable."""
    lines = request.lines
    straight = lines.straight if mode == "contact" else lines.straight_place or lines.straight
    stop = Stop(q, Line(scene.robot, T, q, way), mode, straight)
    usable = stop.usable
    return PlanFailure(stage, usable, what) if isinstance(usable, Refusal) else stop
