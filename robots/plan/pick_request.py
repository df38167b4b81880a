"""The request to the planner of a pick: places, gripper, part, lines, limits, search.

Poses are of the TCP in the robot's base frame, which is the world frame; lengths in [m], times in [s].
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pickproof.cell.frames import Array
from pickproof.robots.collision.held_part import HeldPart
from pickproof.robots.collision.scene import HeightField
from pickproof.robots.motion.dynamics import Load
from pickproof.robots.motion.stop import Pace
from pickproof.robots.motion.trajectory import DT


@dataclass(frozen=True, eq=False)
class PlacePoses:
    """Where the part may be released.

    Attributes:
        Ts_base_tool: (k, 4, 4) TCP, preferred first.
        rank: (k,) preference of each pose, the smallest first; among equals the fastest to reach is used. None for the
            order given.
    """

    Ts_base_tool: Array
    rank: tuple[int, ...] | None = None


@dataclass(frozen=True, eq=False)
class Hand:
    """The gripper on the flange.

    Attributes:
        T_flange_tool: (4, 4).
        load: on the flange, for the torques; None for no load.
        narrowing: time in [s] in which the jaws move from the opening at the start to that of the approach. It begins
            when the gripper has left by `Lines.depart`; until its end the blended motion is free for both openings.
    """

    T_flange_tool: Array
    load: Load | None = None
    narrowing: float = 0.0


@dataclass(frozen=True, eq=False)
class CarriedPart:
    """The gripped part.

    Attributes:
        held: its shape in the TCP frame.
        load: on the flange, for the torques; None for no load.
        tolerance: error of its estimated pose [m] that does not count as a collision on the lift's line.
        pile_without: the scanned pile after the part has left it; None for the scan, which contains the part.
    """

    held: HeldPart
    load: Load | None = None
    tolerance: float = 0.005
    pile_without: HeightField | None = None


@dataclass(frozen=True)
class Lines:
    """Lengths in [m] of the straight tool lines.

    Attributes:
        approach: of the last line, along tool z to the grasp.
        retract: of the first line with the part; retract_direction: a unit vector in the world.
        out_of_bin: of that line up to where the part is out of the bin; where it is longer than `retract` and the arm
            can follow it, the blended motion may begin there at the latest.
        place: of the vertical line down to a place pose.
        depart: of the vertical line away from the start, 0 for none.
        straight: length of each line that must be straight; the rest may be rounded into the blended motion if that is
            free of collisions; None for the whole lines. straight_place: the same for the lines at the place; None for
            the value of the grasp.
    """

    approach: float = 0.10
    retract: float = 0.15
    retract_direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    out_of_bin: float = 0.0
    place: float = 0.12
    depart: float = 0.0
    straight: float | None = None
    straight_place: float | None = None


@dataclass(frozen=True)
class MotionLimits:
    """Limits of speed of the motions.

    Attributes:
        speed: share (0, 1] of the arm's speed, see `robots.motion.trajectory`.
        carry_acceleration: largest acceleration of the TCP with the part [m/s2].
        dt: between samples of a trajectory [s].
    """

    speed: float = 1.0
    carry_acceleration: float = 15.0
    dt: float = DT


@dataclass(frozen=True)
class PathSearch:
    """The search for a path; it runs only where straight moves and via points fail.

    Attributes:
        allowed: whether it runs at all; seed: of its random samples.
    """

    allowed: bool = True
    seed: int = 0


@dataclass(frozen=True, eq=False)
class PickRequest:
    """The request for one pick.

    Attributes:
        q_start: (6,) joint vector at rest now [rad]; q_end: the one to return to, None to wait at the place.
        T_base_tool_grasp: (4, 4) TCP at the grasp; z is the approach direction, x the closing direction of the jaws.
    """

    q_start: Array
    q_end: Array | None
    T_base_tool_grasp: Array
    places: PlacePoses
    hand: Hand
    part: CarriedPart
    lines: Lines = field(default_factory=Lines)
    limits: MotionLimits = field(default_factory=MotionLimits)
    search: PathSearch = field(default_factory=PathSearch)

    @property
    def way_back(self) -> Array:
        """(3,) [m] from the grasp to where the last line to it begins."""
        return np.asarray(-self.lines.approach * self.T_base_tool_grasp[:3, 2])

    @property
    def free(self) -> Pace:
        """Limits with the empty gripper."""
        return Pace(self.limits.speed, self.limits.dt, self.hand.T_flange_tool, None, self.hand.load)

    @property
    def slow(self) -> Pace:
        """Limits with the part."""
        loads = [load for load in (self.hand.load, self.part.load) if load is not None]
        both = sum(loads[1:], loads[0]) if loads else None
        return Pace(self.limits.speed, self.limits.dt, self.hand.T_flange_tool, self.limits.carry_acceleration, both)
