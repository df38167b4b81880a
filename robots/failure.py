"""Reasons for the lack of a motion, as types: planning stage, obstacle, and the two bodies in collision."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

Contact = tuple[str, str]
"""Names of two bodies that touch: a link, a box of the tool or `held`, then the other body."""


class Cause(IntEnum):
    """Kinds of refusal, ordered by how close planning came to a motion."""

    OUT_OF_REACH, JOINT_LIMIT, SINGULARITY, COLLISION, TORQUE, NO_PLACE = range(6)


class Stage(IntEnum):
    """Stages of planning, in order."""

    GRASP, APPROACH_LINE, LIFT_LINE, APPROACH, PLACE, PLACE_LINE, CARRY, LEAVE = range(8)


@dataclass(frozen=True)
class Refusal:
    """The reason why the arm cannot reach a pose or make a motion.

    Attributes:
        joint: 1 to 6, of a joint limit or a torque; 0 of all others.
        contact: of a collision that is known.
        on_line: the collision is on a straight tool line that must be kept.
        early: every tried motion had a collision in the first half of its time.
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
            Cause.TORQUE: f"torque limit of J{self.joint} exceeded",
            Cause.NO_PLACE: "no place pose is given",
        }
        return words[self.cause]


@dataclass(frozen=True)
class PlanFailure:
    """Where planning ended and why; `where` names the pose or motion in words."""

    stage: Stage
    refusal: Refusal
    where: str

    @property
    def cause(self) -> Cause:
        """The reason against the motion."""
        return self.refusal.cause

    @property
    def reason(self) -> Literal["unreachable", "no_path"]:
        """`unreachable` for the arm itself, or `no_path` because of an obstacle."""
        return "no_path" if self.cause == Cause.COLLISION else "unreachable"

    @property
    def detail(self) -> str:
        """One line of text: where, and the reason."""
        return f"{self.where}: {self.refusal}"

    def __str__(self) -> str:
        return f"{self.reason}: {self.detail}"
