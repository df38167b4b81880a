"""Export of a motion as a Fanuc TP program in text form (.LS).

Sources: the listing format of FANUC's R-30iB operator's manual (program detail, motion and register instructions,
position data); configuration: N where J5 is negative, F where it is positive, U with the elbow above the line from J2
to the wrist, T with the wrist centre in front of J1. The controller's world frame has its origin on J1 at the height
of J2, and counts J3 from the horizon (`to_pendant`).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array, make_transform
from pickproof.robots.kinematics.model import RobotModel, forward, to_pendant

NAME = re.compile(r"[A-Z][A-Z0-9_]{0,35}")
TOOL = 1  # number of the tool frame that the program sets and uses
TOOL_REGISTER = 90  # position register through which it is set
XYZWPR = ("X", "Y", "Z", "W", "P", "R")


@dataclass(frozen=True)
class Waypoint:
    """A target point of the program.

    Attributes:
        q: (6,) URDF angles in [rad].
        motion: J: all joints at once; L: the TCP on a straight line.
        speed: J: share of the joint limits in (0, 1]; L: of the TCP in [m/s].
        cnt: rounding in 0 .. 100; None to stop (FINE).
        gripper: action of the gripper at this point, before the next motion.
    """

    q: Array
    motion: Literal["J", "L"]
    speed: float
    cnt: int | None = None
    gripper: Literal["open", "close", ""] = ""


def write_program(
    robot: RobotModel,
    waypoints: Sequence[Waypoint],
    T_flange_tool: Array,
    name: str = "PICK",
    comment: str = "",
    output: int = 1,
    wait: float = 0.2,
) -> str:
    """The program's text.

    Points of L motions are Cartesian in the controller's world frame (UF 0) with the tool frame that the program sets
    (UT 1); those of J motions, and those with a wrist joint beyond half a turn, whose Cartesian form would need turn
    numbers, are joint angles of the pendant.

    Args:
        T_flange_tool: (4, 4) TCP in the flange frame.
        output: robot output RO[n] that closes the gripper when ON.
        wait: for the gripper after it is switched, in [s].

    Raises:
        InputError: the controller does not accept this name.
    """
    if not NAME.fullmatch(name):
        raise InputError("command line", "--name", name, "a letter, then up to 35 of A-Z, 0-9 and _")
    lines = ["UFRAME_NUM=0", f"PR[{TOOL_REGISTER}]=LPOS"]
    for i, value in enumerate(_xyzwpr(T_flange_tool)):
        lines.append(f"PR[{TOOL_REGISTER},{i + 1}]={value:.4f}")
    lines += [f"UTOOL[{TOOL}]=PR[{TOOL_REGISTER}]", f"UTOOL_NUM={TOOL}"]
    positions = []
    for number, point in enumerate(waypoints, 1):
        speed = f"{100 * point.speed:.0f}%" if point.motion == "J" else f"{1000 * point.speed:.0f}mm/sec"
        end = "FINE" if point.cnt is None else f"CNT{point.cnt}"
        lines.append(f"{point.motion} P[{number}] {speed} {end}")
        if point.gripper:
            lines += [f"RO[{output}]={'ON' if point.gripper == 'close' else 'OFF'}", f"WAIT {wait:6.2f}(sec)"]
        positions.append(_position(robot, number, point, T_flange_tool))
    body = "\n".join(_line(i, text) for i, text in enumerate(lines, 1))
    return f"{_head(name, comment, len(lines))}/MN\n{body}\n/POS\n{''.join(positions)}/END\n"


def T_base_world(robot: RobotModel) -> Array:
    """T_base_world (4, 4) of the controller's world frame: origin on J1, at the height of J2."""
    return make_transform(np.eye(3), np.array([0.0, 0.0, robot.opw.c1]))


def configuration(robot: RobotModel, q: ArrayLike) -> str:
    """The configuration of joint angles q (6,) in [rad], such as `N U T`."""
    q = np.asarray(q, dtype=np.float64)
    data = robot.kinematics.createData()
    pin.forwardKinematics(robot.kinematics, data, q)
    shoulder, elbow, wrist = (data.oMi[i].translation for i in (2, 3, 5))
    ahead = np.array([np.cos(q[0]), np.sin(q[0]), 0.0])
    to_elbow, to_wrist = (np.array([p @ ahead, p[2]]) for p in (elbow - shoulder, wrist - shoulder))
    up = to_elbow[0] * to_wrist[1] - to_elbow[1] * to_wrist[0] < 0
    return f"{'N' if q[4] < 0 else 'F'} {'U' if up else 'D'} {'T' if wrist @ ahead > 0 else 'B'}"


def _position(robot: RobotModel, number: int, point: Waypoint, T_flange_tool: Array) -> str:
    head = f"P[{number}]{{\n   GP1:\n\tUF : 0, UT : {TOOL},"
    if point.motion == "J" or np.abs(point.q[3:]).max() >= np.pi:
        pendant = np.rad2deg(to_pendant(point.q))
        values = [f"\tJ{i}= {angle:9.4f} deg" for i, angle in enumerate(pendant, 1)]
        return f"{head}\t\n{_rows(values)}\n}};\n"
    T_world_tool = np.linalg.inv(T_base_world(robot)) @ forward(robot, point.q) @ T_flange_tool
    units = ["mm"] * 3 + ["deg"] * 3
    values = [
        f"\t{key} = {value:9.4f}  {unit}" for key, value, unit in zip(XYZWPR, _xyzwpr(T_world_tool), units, strict=True)
    ]
    return f"{head}\t\tCONFIG : '{configuration(robot, point.q)}, 0, 0, 0',\n{_rows(values)}\n}};\n"


def _rows(values: list[str]) -> str:
    return ",\n".join(",".join(values[i : i + 3]) for i in (0, 3))


def _line(number: int, text: str) -> str:
    motion = re.match(r"[JL] P\[", text)
    return f"{number:4d}:{text}    ;" if motion else f"{number:4d}:  {text} ;"


def _xyzwpr(T: Array) -> Array:
    """Position in [mm], then W, P, R in [deg]: turns about the fixed x, y and z axes, in this order."""
    return np.concatenate([1000 * T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_euler("xyz", degrees=True)])


def _head(name: str, comment: str, lines: int) -> str:
    made = datetime.now(UTC).strftime("DATE %y-%m-%d  TIME %H:%M:%S")
    return f"""/PROG  {name}
/ATTR
OWNER\t\t= MNEDITOR;
COMMENT\t\t= "{comment[:16]}";
PROG_SIZE\t= 0;
CREATE\t\t= {made};
MODIFIED\t= {made};
FILE_NAME\t= ;
VERSION\t\t= 0;
LINE_COUNT\t= {lines};
MEMORY_SIZE\t= 0;
PROTECT\t\t= READ_WRITE;
TCD:  STACK_SIZE\t= 0,
      TASK_PRIORITY\t= 50,
      TIME_SLICE\t= 0,
      BUSY_LAMP_OFF\t= 0,
      ABORT_REQUEST\t= 0,
      PAUSE_REQUEST\t= 0;
DEFAULT_GROUP\t= 1,*,*,*,*;
CONTROL_CODE\t= 00000000 00000000;
"""
