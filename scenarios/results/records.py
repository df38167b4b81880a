"""What is written down of an attempt and of an episode; definitions in docs/reference/definitions.md."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import ArrayLike

from pickproof.scenarios.results.columns import LARGE, OWN_TABLE, columns_of

Rows = tuple[tuple[float, ...], ...]
End = Literal["cleared", "stuck", "stopped"]
ENDS: tuple[End, ...] = ("cleared", "stuck", "stopped")


class Reason(StrEnum):
    """Why an attempt failed; exactly one each, decided from physics and ground truth after the fact."""

    NO_DETECTION = "no_detection"
    WRONG_POSE = "wrong_pose"
    ALL_GRASPS_BLOCKED = "all_grasps_blocked"
    NO_PLACE = "no_place"
    UNREACHABLE = "unreachable"
    NO_PATH = "no_path"
    COLLISION = "collision"
    MISSED = "missed"
    SLIPPED = "slipped"
    DROPPED = "dropped"
    DOUBLE_PICK = "double_pick"
    MISPLACED = "misplaced"
    EJECTED = "ejected"
    TIMEOUT = "timeout"
    SIMULATION_ERROR = "simulation_error"


NO_PICK_REASONS = frozenset(
    {Reason.NO_DETECTION, Reason.ALL_GRASPS_BLOCKED, Reason.NO_PLACE, Reason.UNREACHABLE, Reason.NO_PATH}
)
"""Decisions not to move; they are no attempts and are counted beside the rate."""

MEANING = {
    Reason.NO_DETECTION: "no workpiece was found that could be verified",
    Reason.WRONG_POSE: "the estimate was outside tolerance of every workpiece",
    Reason.ALL_GRASPS_BLOCKED: "no grasp left room for the gripper",
    Reason.NO_PLACE: "no free grasp allows the wanted place; it takes a regrasp",
    Reason.UNREACHABLE: "no free grasp was within the arm's reach",
    Reason.NO_PATH: "no collision-free motion was found",
    Reason.COLLISION: "arm or gripper touched something too hard",
    Reason.MISSED: "the gripper closed on nothing",
    Reason.SLIPPED: "lost while lifting",
    Reason.DROPPED: "lost on the way to the place bin",
    Reason.DOUBLE_PICK: "more than one workpiece came along",
    Reason.MISPLACED: "not at rest in the place bin, or out of tolerance",
    Reason.EJECTED: "another workpiece left the bin",
    Reason.TIMEOUT: "took longer than the scenario allows",
    Reason.SIMULATION_ERROR: "the simulation broke down",
}


def nested(array: ArrayLike) -> Rows:
    """A matrix (n, m) as nested tuples of floats, the form in which records hold matrices."""
    rows = cast(Iterable[Iterable[float]], array)
    if not isinstance(array, list):  # as read from JSON; there, numpy takes longer than all else
        rows = np.asarray(array, dtype=np.float64).tolist()
    return tuple(tuple(map(float, row)) for row in rows)


@cache
def _conversions(record: type) -> tuple[tuple[str, Callable[[Any], Any]], ...]:
    """Field -> what makes a plain number or nested tuples of its value."""
    numbers = [(c.name, c.kind) for c in columns_of(record) if c.kind in (int, bool, float)]
    matrices = [(c.name, nested) for c in columns_of(record) if c.hint == Rows]
    return (*numbers, *matrices)


@dataclass(frozen=True)
class AttemptRecord:
    """One attempt, or one decision not to move.

    Attributes:
        seed: of the episode.
        attempt: index within the episode, from 0; no-picks are numbered along.
        moved: the arm was commanded to move; False for a no-pick.
        reason: why it failed; empty for a success.
        parts_in_bin_before: workpieces in the source bin when the picture was taken.
        n_estimates: poses that perception handed on.
        estimate_T_world_part: (4, 4) of the chosen estimate, None where none was chosen.
        estimate_score: of the chosen estimate, in [0, 1].
        error_mm, error_deg: chosen estimate against the nearest true pose; None in no-picks.
        place_mm, place_deg: of a workpiece that was carried to the place bin, how far it rests from where it was to be
            let go, horizontally and in rotation; None of others.
        grasp: name of the grasp point, empty where none was chosen.
        sensing_s, perceive_s, choose_s, plan_s, robot_s: sensing time of the scenario, measured compute times, and
            duration of the trajectories, in [s].
        part_poses_after: (n, 7) of all workpieces: position [m] and quaternion in the order x, y, z, w.
        tree: estimates -> grasps -> first reason that ruled each out; JSON.
        waypoints: points of the motion in order, as `robots.program.waypoints.waypoints_to_json` gives them; None in
            no-picks.
        pictures: name -> PNG.
        wall_s: wall time of the attempt in [s].
    """

    seed: int
    attempt: int
    moved: bool
    success: bool
    reason: Reason | Literal[""]
    parts_in_bin_before: int
    n_estimates: int
    estimate_T_world_part: Rows | None = None
    estimate_score: float | None = None
    error_mm: float | None = None
    error_deg: float | None = None
    grasp: str = ""
    sensing_s: float = 0.0
    perceive_s: float = 0.0
    choose_s: float = 0.0
    plan_s: float = 0.0
    robot_s: float = 0.0
    part_poses_after: Rows = ()
    tree: Any = field(default=None, metadata=LARGE)
    pictures: dict[str, bytes] = field(default_factory=dict, metadata=OWN_TABLE)
    wall_s: float = 0.0
    place_mm: float | None = None
    place_deg: float | None = None
    waypoints: Any = field(default=None, metadata=LARGE)

    def __post_init__(self) -> None:
        self._normalise()
        if self.success != (self.reason == ""):
            raise ValueError(f"success {self.success} with reason {self.reason!r}")
        if self.reason != "":
            object.__setattr__(self, "reason", Reason(self.reason))
        if self.moved == (self.reason in NO_PICK_REASONS):
            raise ValueError(f"moved {self.moved} with reason {self.reason!r}")

    def _normalise(self) -> None:
        """Plain Python numbers, whatever numpy type they came as, so that a record stores and hashes one way."""
        record: type = type(self)
        for name, convert in _conversions(record):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, convert(value))

    @property
    def compute_s(self) -> float:
        """Measured compute time in [s]."""
        return self.perceive_s + self.choose_s + self.plan_s

    @property
    def cycle_s(self) -> float:
        """Sensing + compute + robot time in [s]."""
        return self.sensing_s + self.compute_s + self.robot_s


@dataclass(frozen=True)
class EpisodeRecord:
    """One seeded bin fill, attempted until its end.

    Attributes:
        parts_dropped: workpieces dropped into the bin.
        parts_picked: successful attempts.
        attempts: attempts and no-picks together, the number of AttemptRecords.
        wall_s: wall time in [s], filling the bin included.
    """

    seed: int
    parts_dropped: int
    parts_picked: int
    end: End
    attempts: int
    wall_s: float
