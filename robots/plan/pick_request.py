"""What the planner of a pick is asked for, in parts: places, hand, part, lines, limits, search.

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
    """Where the part may be let go.

    Attributes:
        Ts_base_tool: (k, 4, 4) TCP, most wanted first.
        rank: (k,) how much each pose is wanted, the least first; among equals the quickest to reach is taken. None for
            the order given.
    """

    Ts_base_tool: Array
    rank: tuple[int, ...] | None = None


@dataclass(frozen=True, eq=False)
class Hand:
    """The gripper on the flange.

    Attributes:
        T_flange_tool: (4, 4).
        load: what it weighs on the flange, for the torques; None for nothing.
        narrowing: time in [s] that the jaws take from how they are at the start to how they grip. They start when the
            hand has left by `Lines.depart`, and until they are done the blended motion has room for both.
    """

    T_flange_tool: Array
    load: Load | None = None
    narrowing: float = 0.0


@dataclass(frozen=True, eq=False)
class CarriedPart:
    """The part once it is gripped.

    Attributes:
        held: its shape in the TCP frame.
        load: what it weighs on the flange, for the torques; None for nothing.
        tolerance: error of its estimated pose [m] that does not count as a collision on the lift's line.
        pile_without: the scanned pile once the part is out of it; None for the scan as it is, the part in it.
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
            can follow it, the blended motion may begin as late as there.
        place: of the vertical line down to a place pose.
        depart: of the vertical line away from the start, 0 for none.
        straight: how much of each line is kept straight where the rest of it may be rounded into the blended motion
            without a touch; None for the whole lines. straight_place: the same of the lines at the place; None for as
            much as at the grasp.
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
    """How fast the motions may be.

    Attributes:
        speed: in (0, 1] of the arm's speed, see `robots.motion.trajectory`.
        carry_acceleration: largest acceleration of the TCP with the part [m/s2].
        dt: between samples of a trajectory [s].
    """

    speed: float = 1.0
    carry_acceleration: float = 15.0
    dt: float = DT


@dataclass(frozen=True)
class PathSearch:
    """The search for a path, which runs only where straight moves and via points fail.

    Attributes:
        allowed: whether it runs at all; seed: of its random samples.
    """

    allowed: bool = True
    seed: int = 0


@dataclass(frozen=True, eq=False)
class PickRequest:
    """What one pick asks for.

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
        """Pace of the empty hand."""
        return Pace(self.limits.speed, self.limits.dt, self.hand.T_flange_tool, None, self.hand.load)

    @property
    def slow(self) -> Pace:
        """Pace with the part."""
        loads = [load for load in (self.hand.load, self.part.load) if load is not None]
        both = sum(loads[1:], loads[0]) if loads else None
        return Pace(self.limits.speed, self.limits.dt, self.hand.T_flange_tool, self.limits.carry_acceleration, both)
