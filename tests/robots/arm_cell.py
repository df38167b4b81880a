"""The cell that the robot tests share: arm on a table, a source bin in front of it, a place bin beside it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from pickproof.cell.frames import Array, about_axis, make_transform
from pickproof.cell.geometry.bin import Bin, Box, table
from pickproof.cell.workpiece.collision_pieces import CollisionBox
from pickproof.robots.collision.held_part import HeldPart
from pickproof.robots.kinematics.model import RobotModel
from pickproof.robots.motion.dynamics import Load, torques
from pickproof.robots.motion.trajectory import Trajectory
from pickproof.robots.plan.pick_request import CarriedPart, Hand, PickRequest, PlacePoses

DOWN = np.diag([1.0, -1.0, -1.0])
T_FLANGE_TOOL = make_transform(t=(0, 0, 0.16))
TOOL = (
    Box("palm", (0.05, 0.10, 0.09), make_transform(t=(0, 0, 0.045))),
    Box("finger_left", (0.005, 0.010, 0.070), make_transform(t=(-0.02, 0, 0.125))),
    Box("finger_right", (0.005, 0.010, 0.070), make_transform(t=(0.02, 0, 0.125))),
)
PART = HeldPart((CollisionBox(size=(0.018, 0.056, 0.014), centre=(0, 0, 0.002)),), make_transform())
SOURCE = Bin("source", (0.26, 0.20, 0.08), 0.006, (0.45, 0.0, 0.01))
PLACE = Bin("place", (0.26, 0.20, 0.08), 0.006, (0.25, -0.40, 0.01))
CELL = (table((1.4, 1.4, 0.05), (0.2, 0, 0)), *SOURCE.boxes(), *PLACE.boxes())


def tilted(tilt_deg: float, azimuth_deg: float, roll_deg: float) -> Array:
    """Rotation of a tool that leans from straight down by `tilt`, towards `azimuth`."""
    tilt, azimuth, roll = np.deg2rad([tilt_deg, azimuth_deg, roll_deg])
    turns = [about_axis((0, 0, 1), azimuth), about_axis((1, 0, 0), np.pi - tilt), about_axis((0, 0, 1), roll - azimuth)]
    return (turns[0] @ turns[1] @ turns[2])[:3, :3]


def request_at(robot: RobotModel, x: float, y: float, R: Array = DOWN, z: float = 0.035) -> PickRequest:
    """A pick at (x, y, z) with three place poses in the place bin."""
    places = np.stack([make_transform(DOWN, (0.25 + dx, -0.40, 0.06)) for dx in (0.0, -0.07, 0.07)])
    parts = PlacePoses(places), Hand(T_FLANGE_TOOL), CarriedPart(PART)
    return PickRequest(robot.home, robot.home, make_transform(R, (x, y, z)), *parts)


def changed(request: PickRequest, **fields: Any) -> PickRequest:
    """The request with other values; those of a part of it as a mapping: `lines={"straight": 0.02}`."""
    parts = {name: replace(getattr(request, name), **v) if isinstance(v, dict) else v for name, v in fields.items()}
    return replace(request, **parts)


def share_of_limits(robot: RobotModel, trajectory: Trajectory, load: Load) -> Array:
    """Largest torque of each joint (6,) along a trajectory as a share of its limit."""
    return np.asarray(np.abs(torques(robot, trajectory, load)).max(axis=0) / robot.effort)
