"""Rigid transforms and the notation `T_a_b`.

`T_a_b` is a 4x4 float64 matrix that maps coordinates of frame b to coordinates of frame a, so adjacent frames in a
chain must match: `T_world_part = T_world_camera @ T_camera_part`. `Ts` is a stack of them, shape (..., 4, 4).
Quaternions are ordered x, y, z, w (PyBullet, SciPy) and the order is in the name wherever one appears.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


def make_transform(R: ArrayLike | None = None, t: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
    """Transform from a rotation matrix (..., 3, 3) and a translation (..., 3) in [m]."""
    R = np.eye(3) if R is None else np.asarray(R, dtype=np.float64)
    t = np.asarray(t, dtype=np.float64)
    shape = np.broadcast_shapes(R.shape[:-2], t.shape[:-1])
    T = np.zeros((*shape, 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, t, 1.0
    return T


def invert(T: Array) -> Array:
    """Inverse of rigid transforms (..., 4, 4)."""
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    return make_transform(Rt, -(Rt @ T[..., :3, 3:])[..., 0])


def apply(T: Array, points: Array) -> Array:
    """Map points (..., n, 3) by transforms (..., 4, 4)."""
    return points @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3]


def from_quat_xyzw(t: ArrayLike, quat_xyzw: ArrayLike) -> Array:
    """Transform from a translation (..., 3) in [m] and a quaternion (..., 4) in the order x, y, z, w."""
    return make_transform(Rotation.from_quat(np.asarray(quat_xyzw)).as_matrix(), t)


def to_quat_xyzw(T: Array) -> Array:
    """Quaternion (..., 4) in the order x, y, z, w of the rotation of T (..., 4, 4)."""
    R = T[..., :3, :3]
    return Rotation.from_matrix(R.reshape(-1, 3, 3)).as_quat().reshape(*R.shape[:-2], 4)


def from_rpy(t: ArrayLike = (0.0, 0.0, 0.0), rpy: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
    """Transform from a translation in [m] and fixed-axis roll, pitch, yaw in [rad] (the URDF convention)."""
    return make_transform(Rotation.from_euler("xyz", np.asarray(rpy)).as_matrix(), t)


def about_axis(axis: ArrayLike, angle: ArrayLike) -> Array:
    """Rotation transforms (..., 4, 4) by `angle` (...) in [rad] about a unit `axis` (3,) through the origin."""
    angle = np.asarray(angle, dtype=np.float64)
    rotvec = angle[..., None] * np.asarray(axis, dtype=np.float64)
    R = Rotation.from_rotvec(rotvec.reshape(-1, 3)).as_matrix()
    return make_transform(R.reshape(*angle.shape, 3, 3))


def rotation_angle(R: Array) -> Array:
    """Angle in [rad] of rotation matrices (..., 3, 3), exact near 0 and near pi."""
    n = R.shape[:-2]
    return Rotation.from_matrix(R.reshape(-1, 3, 3)).magnitude().reshape(n)


def random_rotations(n: int, rng: np.random.Generator) -> Array:
    """Uniform rotation matrices (n, 3, 3): normalised Gaussian quaternions (Shoemake 1992)."""
    q = rng.standard_normal((n, 4))
    return Rotation.from_quat(q / np.linalg.norm(q, axis=1, keepdims=True)).as_matrix()
