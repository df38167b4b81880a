"""Why there is no motion, as types: how far planning came, what was in the way, and between which two bodies."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

Contact = tuple[str, str]
"""Names of two bodies that touch: a link, a box of the tool or `held`, then what it touches."""


class Cause(IntEnum):
    """What is in the way; the later ones are the nearer to a motion."""

    OUT_OF_REACH, JOINT_LIMIT, SINGULARITY, COLLISION, TORQUE, NO_PLACE = range(6)


class Stage(IntEnum):
    """How far a plan came."""

    GRASP, APPROACH_LINE, LIFT_LINE, APPROACH, PLACE, PLACE_LINE, CARRY, LEAVE = range(8)


@dataclass(frozen=True)
class Refusal:
    """Why the arm cannot stand or move somewhere.

    Attributes:
        joint: 1 to 6, of a joint limit or a torque; 0 of all others.
        contact: of a collision that is known.
        on_line: the collision is on a straight tool line that must be kept.
        early: whatever was tried touched something in the first half of its time.
    """

    cause: Cause
    joint: int = 0
    contact: Contact | None = None
    on_line: bool = False
    early: bool = False

    def __str__(self) -> str:
        if self.cause == Cause.COLLISION:
            touch = "no way" if self.contact is None else f"{self.contact[0]} touches {self.contact[1]}"
            return f"on the line, {touch}" if self.on_line else touch
        words = {
            Cause.OUT_OF_REACH: "out of reach",
            Cause.JOINT_LIMIT: f"joint limit of J{self.joint}",
            Cause.SINGULARITY: "singularity margin",
            Cause.TORQUE: f"more torque than the motor of J{self.joint} has",
            Cause.NO_PLACE: "no place pose was given",
        }
        return words[self.cause]


@dataclass(frozen=True)
class PlanFailure:
    """Where planning ended and why; `where` names the pose or motion for a reader."""

    stage: Stage
    refusal: Refusal
    where: str

    @property
    def cause(self) -> Cause:
        """What stood against the motion."""
        return self.refusal.cause

    @property
    def reason(self) -> Literal["unreachable", "no_path"]:
        """`unreachable` by the arm alone, or `no_path` because something is in the way."""
        return "no_path" if self.cause == Cause.COLLISION else "unreachable"

    @property
    def detail(self) -> str:
        """One line for a reader: where, and what stood against it."""
        return f"{self.where}: {self.refusal}"

    def __str__(self) -> str:
        return f"{self.reason}: {self.detail}"
