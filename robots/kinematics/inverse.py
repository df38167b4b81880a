"""Closed-form inverse kinematics: every branch of every pose at once.

An ortho-parallel arm with a spherical wrist has eight branches a pose (Brandstoetter, Angerer, Hofbaur 2014,
"An analytical solution of the inverse kinematics problem of industrial serial manipulators with an ortho-parallel
basis and a spherical wrist"). A branch is one number, 4 * wrist + 2 * shoulder + elbow:
shoulder 0 faces the wrist centre, 1 reaches back over the base; elbow and wrist are the signs of the two inner roots.
It is constant along a motion that does not pass a singularity.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from py_opw_kinematics import KinematicModel, RigidTransform, Robot

from pickproof.cell.frames import Array
from pickproof.robots.kinematics.chain import flanges
from pickproof.robots.kinematics.model import OpwConfig, RobotModel

FRONT = (0, 4)  # shoulder faces the bin, elbow up; with the elbow down the arm collides with itself or the bin first
SIGMA_MIN = 0.03  # [m/rad and rad/rad]; below this, joint speeds are too high for the tool speed


@dataclass(frozen=True)
class Branches:
    """All branches of n flange poses.

    Attributes:
        q: joint vectors (n, 8, 6) in [rad]; of equivalent angles, the closest to the reference. NaN where none.
        valid: (n, 8) the branch exists and keeps the joint limits.
        exists: (n, 8) the branch exists, within the limits or not.
        sigma: (n, 8) smallest singular value of the flange's geometric Jacobian, 0 where no valid branch exists.
    """

    q: Array
    valid: np.ndarray
    exists: np.ndarray
    sigma: Array


def inverse(model: RobotModel, Ts_base_flange: Array, q_near: ArrayLike | None = None) -> Branches:
    """Every branch of flange poses (n, 4, 4), with joints shifted by multiples of 2 pi into the limits.

    Args:
        q_near: (6,) in [rad], default home: of equivalent angles within the limits, the closest is returned.
    """
    near = np.asarray(model.home if q_near is None else q_near, dtype=np.float64)
    Ts = np.asarray(Ts_base_flange, dtype=np.float64).reshape(-1, 4, 4)
    # The solver's angles lie in [-pi, pi]; it omits the singular values of branches outside these limits.
    never = (model.lower > -np.pi) & (model.upper < np.pi)
    limits = np.stack([np.where(never, model.lower, -7.0), np.where(never, model.upper, 7.0)], axis=1)
    found = _solver(model.opw).reach(RigidTransform.from_matrix(Ts), joint_limits=limits)
    q = _turn(model, found.joints, near)
    exists = ~np.isnan(found.joints[..., 0])
    valid = exists & model.within_limits(q)
    return Branches(q, valid, exists, np.nan_to_num(found.sigma_min))


def flange_poses(model: RobotModel, q: Array) -> Array:
    """T_base_flange (n, 4, 4) at q (n, 6) in [rad], as `model.forward` but by the closed form: faster for many."""
    return np.asarray(flanges(arm_of(model), np.ascontiguousarray(q, np.float64)))


def arm_of(model: RobotModel) -> Array:
    """(19,) parameters as `robots.kinematics.chain` has them."""
    return _parameters(model.opw)


def branch(model: RobotModel, q: ArrayLike) -> np.ndarray:
    """Branch number (...) of joint vectors q (..., 6) in [rad], the slot in which `inverse` returns them."""
    o = model.opw
    theta = _angles(model, q)
    psi3, k = np.arctan2(o.a2, o.c3), np.hypot(o.a2, o.c3)
    elbow_angle = theta[..., 2] + psi3
    wrist_x = o.a1 + o.c2 * np.sin(theta[..., 1]) + k * np.sin(theta[..., 1] + elbow_angle)
    return np.asarray(4 * (np.sin(theta[..., 4]) < 0) + 2 * (wrist_x < 0) + (np.sin(elbow_angle) < 0), dtype=np.int64)


def reachable(
    model: RobotModel, Ts_base_tool: Array, T_flange_tool: Array, sigma_min: float = SIGMA_MIN
) -> tuple[np.ndarray, Array]:
    """Which TCP poses (n, 4, 4) have a front-facing branch within limits and away from singularities.

    Returns:
        mask (n,), and the largest sigma_min (n,) over those branches, 0 where there is none.
    """
    found = inverse(model, np.asarray(Ts_base_tool) @ np.linalg.inv(T_flange_tool))
    front = list(FRONT)
    sigma = np.where(found.valid[:, front], found.sigma[:, front], 0.0).max(axis=1, initial=0.0)
    return sigma > sigma_min, sigma


def _angles(model: RobotModel, q: ArrayLike) -> Array:
    """Angles of the closed form's own convention at joint vectors q (..., 6)."""
    signs, offsets = np.where(model.opw.flips, -1.0, 1.0), np.deg2rad(model.opw.offsets_deg)
    return np.asarray(np.asarray(q, dtype=np.float64) * signs - offsets)


def _turn(model: RobotModel, q: Array, near: Array) -> Array:
    """Of q + 2 pi k within the limits, the one closest to `near`; the closest of all where none is within."""
    turn = 2 * np.pi
    wanted = np.round((near - q) / turn)
    first, last = np.ceil((model.lower - q) / turn), np.floor((model.upper - q) / turn)
    return np.asarray(q + turn * np.where(first <= last, np.clip(wanted, first, last), wanted))


@lru_cache(maxsize=8)
def _parameters(o: OpwConfig) -> Array:
    signs, offsets = np.where(o.flips, -1.0, 1.0), np.deg2rad(o.offsets_deg)
    return np.array([o.a1, o.a2, o.b, o.c1, o.c2, o.c3, o.c4, *signs, *offsets])


@lru_cache(maxsize=8)
def _solver(o: OpwConfig) -> Robot:
    offsets = tuple(np.deg2rad(o.offsets_deg))
    lengths = {"a1": o.a1, "a2": o.a2, "b": o.b, "c1": o.c1, "c2": o.c2, "c3": o.c3, "c4": o.c4}
    return Robot(KinematicModel(**lengths, offsets=offsets, flip_axes=o.flips), degrees=False)
