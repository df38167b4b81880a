"""Reads back the Fanuc TP programs that `write_program` writes."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from pickproof.cell.frames import Array, make_transform
from pickproof.robots.kinematics.model import RobotModel, from_pendant
from pickproof.robots.program.tp_program import TOOL_REGISTER, XYZWPR, T_base_world


@dataclass(frozen=True)
class Position:
    """P[n] as it stands in a program: `joints` (6,) in [rad] by the URDF's count, or `T_base_tool` with `config`."""

    joints: Array | None
    T_base_tool: Array | None
    config: str = ""


@dataclass(frozen=True)
class Program:
    """What `parse_program` read.

    Attributes:
        moves: motion letter, number of the position, speed as in `Waypoint`, rounding (None: FINE).
        outputs: robot outputs set, in order: number and state.
        T_flange_tool: tool frame that the program sets, to the digits printed.
    """

    name: str
    moves: list[tuple[str, int, float, int | None]]
    outputs: list[tuple[int, bool]]
    positions: dict[int, Position]
    T_flange_tool: Array


def parse_program(text: str, robot: RobotModel) -> Program:
    """Read a program that `write_program` wrote.

    Raises:
        ValueError: no program of that form.
    """
    found = re.search(r"^/PROG\s+(\w+).*?^/MN\n(.*?)^/POS\n(.*?)^/END", text, re.S | re.M)
    if found is None:
        raise ValueError("no /PROG, /MN, /POS and /END in this order")
    name, body, tail = found.groups()
    moves, outputs = [], []
    for kind, number, speed, unit, end in re.findall(r":([JL]) P\[(\d+)\] (\d+)(%|mm/sec) (FINE|CNT\d+)", body):
        share = float(speed) / (100 if unit == "%" else 1000)
        moves.append((kind, int(number), share, None if end == "FINE" else int(end[3:])))
    for number, state in re.findall(r"RO\[(\d+)\]=(ON|OFF)", body):
        outputs.append((int(number), state == "ON"))
    frame = dict(re.findall(rf"PR\[{TOOL_REGISTER},(\d)\]=([-\d.]+)", body))
    T_flange_tool = _transform([float(frame[str(i)]) for i in range(1, 7)])
    positions = {}
    for number, block in re.findall(r"P\[(\d+)\]\{(.*?)\};", tail, re.S):
        values = dict(re.findall(r"(J\d|[XYZWPR])\s*=\s*([-\d.]+)", block))
        config = re.search(r"CONFIG : '([^']*)'", block)
        if config is None:
            pendant = np.deg2rad([float(values[f"J{i}"]) for i in range(1, 7)])
            positions[int(number)] = Position(from_pendant(pendant), None)
        else:
            T_world_tool = _transform([float(values[key]) for key in XYZWPR])
            positions[int(number)] = Position(None, T_base_world(robot) @ T_world_tool, config.group(1))
    return Program(name, moves, outputs, positions, T_flange_tool)


def _transform(xyzwpr: Sequence[float]) -> Array:
    turn = Rotation.from_euler("xyz", xyzwpr[3:], degrees=True).as_matrix()
    return make_transform(turn, np.array(xyzwpr[:3]) / 1000)
