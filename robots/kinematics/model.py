"""The arm: limits, kinematic parameters and forward kinematics."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from pydantic import Field

from pickproof.cell.config import Config, Length, Offset, load
from pickproof.cell.errors import InputError, did_you_mean
from pickproof.cell.frames import Array

SHIPPED = Path(__file__).resolve().parents[1]

Six = tuple[float, float, float, float, float, float]


class OpwConfig(Config):
    """Lengths [m], offsets [deg] and flips of an ortho-parallel arm with a spherical wrist (Brandstoetter 2014)."""

    a1: Offset = Field(description="[m]")
    a2: Offset = Field(description="[m]")
    b: Offset = Field(description="[m]")
    c1: Offset = Field(description="[m]")
    c2: Offset = Field(description="[m]")
    c3: Offset = Field(description="[m]")
    c4: Offset = Field(description="[m]")
    offsets_deg: Six = Field(description="added to each joint angle")
    flips: tuple[bool, bool, bool, bool, bool, bool] = Field(description="joints with reversed direction")


class RobotConfig(Config):
    """Schema of robot.yaml."""

    name: str = Field(description="that of the folder")
    urdf: str = Field(description="file beside this one")
    joints: tuple[str, str, str, str, str, str] = Field(description="names in the URDF, from the base on")
    flange: str = Field(description="link of the URDF at which the gripper is mounted")
    payload: float = Field(gt=0, description="[kg]")
    reach: Length = Field(description="J1 axis to wrist centre [m]")
    opw: OpwConfig = Field(description="parameters of the inverse kinematics")
    velocity_deg: Six = Field(description="[deg/s] limit of each joint")
    time_to_velocity: float = Field(gt=0, description="v_max / a_max [s]")
    time_to_acceleration: float = Field(gt=0, description="a_max / j_max [s]")
    home_deg: Six = Field(description="[deg] initial pose, outside the view of the camera")


@dataclass(frozen=True, eq=False)
class RobotModel:
    """A six-axis arm whose base frame is the world frame.

    Attributes:
        urdf: its file; collision and visual shapes are primitives.
        joints: joint names in the order of every q (6,).
        lower, upper: joint limits (6,) in [rad], from the URDF.
        velocity, acceleration, jerk: limits (6,) in [rad/s], [rad/s2], [rad/s3]; robot.yaml assumes the last two.
        effort: torque limits (6,) in [N m], from the URDF; robot.yaml states how reliable they are.
        home: (6,) in [rad]; outside the camera's view of the bin.
        payload: in [kg]; reach: from the J1 axis to the wrist centre in [m].
        kinematics: Pinocchio's model; flange: its frame id.
    """

    name: str
    urdf: Path
    joints: tuple[str, ...]
    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    jerk: Array
    effort: Array
    home: Array
    payload: float
    reach: float
    opw: OpwConfig
    kinematics: pin.Model
    flange: int

    def within_limits(self, q: ArrayLike, margin: float = 0.0) -> np.ndarray:
        """Which joint vectors (..., 6) in [rad] keep `margin` [rad] from every limit."""
        q = np.asarray(q, dtype=np.float64)
        return np.asarray(((q >= self.lower + margin) & (q <= self.upper - margin)).all(axis=-1))


def list_robots() -> list[str]:
    """Names of all shipped robots."""
    return sorted(p.parent.name for p in SHIPPED.glob("*/robot.yaml"))


def load_robot(name: str) -> RobotModel:
    """Load a shipped robot.

    Raises:
        InputError: unknown name, invalid robot.yaml, or a URDF that does not match it.
    """
    if name not in list_robots():
        known = list_robots()
        raise InputError("command line", "robot", name, f"one of: {', '.join(known)}{did_you_mean(name, known)}")
    path = SHIPPED / name / "robot.yaml"
    config = load(RobotConfig, path)
    urdf = path.parent / config.urdf
    if not urdf.is_file():
        raise InputError(path, "urdf", config.urdf, "an existing URDF beside it")
    model = pin.buildModelFromUrdf(str(urdf))
    names = tuple(model.names)[1:]
    if names != config.joints:
        raise InputError(path, "joints", config.joints, f"the joints of {urdf.name}: {', '.join(names)}")
    if not model.existFrame(config.flange):
        raise InputError(path, "flange", config.flange, f"a link of {urdf.name}")
    velocity = np.deg2rad(config.velocity_deg)
    acceleration = velocity / config.time_to_velocity
    return RobotModel(
        name=config.name,
        urdf=urdf,
        joints=names,
        lower=_frozen(model.lowerPositionLimit),
        upper=_frozen(model.upperPositionLimit),
        velocity=_frozen(velocity),
        acceleration=_frozen(acceleration),
        jerk=_frozen(acceleration / config.time_to_acceleration),
        effort=_frozen(model.effortLimit),
        home=_frozen(np.deg2rad(config.home_deg)),
        payload=config.payload,
        reach=config.reach,
        opw=config.opw,
        kinematics=model,
        flange=model.getFrameId(config.flange),
    )


def forward(model: RobotModel, q: ArrayLike) -> Array:
    """Flange poses T_base_flange (n, 4, 4) at joint vectors q (n, 6) in [rad]; (6,) gives (4, 4). Pinocchio."""
    q = np.asarray(q, dtype=np.float64)
    data = model.kinematics.createData()
    out = np.empty((*q.shape[:-1], 4, 4))
    for k in np.ndindex(q.shape[:-1]):
        pin.framesForwardKinematics(model.kinematics, data, q[k])
        out[k] = data.oMf[model.flange].homogeneous
    return out


def from_pendant(q_pendant: ArrayLike) -> Array:
    """URDF angles (..., 6) of pendant angles [rad]: the controller measures J3 from the horizon, so J2 is added."""
    q = np.array(q_pendant, dtype=np.float64)
    q[..., 2] += q[..., 1]
    return q


def to_pendant(q: ArrayLike) -> Array:
    """Pendant angles (..., 6) of URDF angles [rad], the inverse of `from_pendant`."""
    q_pendant = np.array(q, dtype=np.float64)
    q_pendant[..., 2] -= q_pendant[..., 1]
    return q_pendant


def _frozen(a: ArrayLike) -> Array:
    out = np.array(a, dtype=np.float64)
    out.flags.writeable = False
    return out
