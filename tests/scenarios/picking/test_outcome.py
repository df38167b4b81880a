"""What counts as a success: by the definition, and by attempts that only look like one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pickproof.cell.frames import about_axis, make_transform
from pickproof.cell.physics.observation import Snapshot
from pickproof.cell.physics.trajectory_execution import MotionLog
from pickproof.cell.symmetry.symmetry import Symmetry
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.scenarios.picking.outcome import judge, nearest_true
from pickproof.scenarios.picking.stages import Evidence
from pickproof.scenarios.results.records import Reason

LIMIT_N, LIMIT_S = 50.0, 30.0
BEFORE = "source source source place"
"""Three workpieces in the source bin, one placed earlier; the attempts below are on number 0."""


def snapshot(bins: str, moving: tuple[int, ...] = ()) -> Snapshot:
    """Workpieces by the bins they lie in, `-` for none."""
    names = tuple(name.replace("-", "") for name in bins.split())
    at_rest = np.array([i not in moving for i in range(len(names))])
    return Snapshot(1.0, np.tile(np.eye(4), (len(names), 1, 1)), names, at_rest)


SUCCESS = Evidence(
    before=snapshot(BEFORE),
    after=snapshot("place source source place"),
    closed=(0,),
    lifted=(0,),
    carried=(0,),
    released=True,
    log=MotionLog(time=5.0, max_force=3.0),
    seconds=5.0,
    pose_ok=True,
)


def verdict(**changes: object) -> str:
    return str(judge(replace(SUCCESS, **changes), LIMIT_N, LIMIT_S))


def after(bins: str, moving: tuple[int, ...] = ()) -> Snapshot:
    return snapshot(bins, moving)


def test_a_plain_pick_is_a_success() -> None:
    assert verdict() == ""


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        # nobody held it
        ({"closed": (), "lifted": (), "carried": ()}, "ejected"),  # flung into the place bin
        ({"closed": (), "lifted": (), "carried": (), "after": after(BEFORE)}, "missed"),
        ({"closed": (), "lifted": (), "carried": (), "after": after("- source source place")}, "ejected"),
        # held for a while
        ({"lifted": (), "carried": ()}, "slipped"),  # fell from the lift and bounced into the place bin
        ({"lifted": (), "carried": (), "after": after(BEFORE)}, "slipped"),
        ({"lifted": (), "carried": (), "after": after("- source source place")}, "slipped"),
        ({"carried": ()}, "dropped"),  # fell in the transfer, into the place bin by luck
        ({"carried": (), "after": after("- source source place")}, "dropped"),
        ({"carried": (), "after": after(BEFORE)}, "dropped"),
        # carried, but not placed
        ({"released": False}, "misplaced"),
        ({"after": after("- source source place")}, "misplaced"),  # on the rim, on the table
        ({"after": after(BEFORE)}, "misplaced"),  # came back with the gripper
        ({"after": after("place source source place", moving=(0,))}, "misplaced"),
        # two
        ({"closed": (0, 1), "lifted": (0, 1), "carried": (0, 1)}, "double_pick"),
        ({"lifted": (0, 1)}, "double_pick"),
        ({"carried": (0, 1)}, "double_pick"),
        ({"after": after("place place source place")}, "double_pick"),  # hooked on, between no fingers
        ({"put_back": True, "carried": (), "after": after(BEFORE)}, "double_pick"),  # too heavy at the wrist
        ({"put_back": True, "carried": (), "after": after("- source source place")}, "double_pick"),
        ({"put_back": True, "carried": (), "after": after("source - source place")}, "ejected"),
        # another one out of its bin
        ({"after": after("place - source place")}, "ejected"),
        ({"after": after("place source source -")}, "ejected"),  # knocked out of the place bin
        ({"after": after("place source source source")}, "ejected"),
        ({"closed": (0, 1), "after": after("place - source place")}, "ejected"),  # let go of 1, over the wall
        ({"closed": (0, 1), "lifted": (0, 1), "carried": (0,), "after": after("place - source place")}, "double_pick"),
        ({"closed": (), "lifted": (), "carried": (), "after": after("source source - place")}, "ejected"),
        ({"lifted": (), "carried": (), "after": after("source - source place")}, "ejected"),
        # a part that was nowhere, or placed before, is no pick
        ({"before": snapshot("- source source place")}, "misplaced"),
        ({"before": snapshot("place source source place")}, "misplaced"),
        # limits
        ({"log": MotionLog(max_force=50.1)}, "collision"),
        ({"seconds": 30.1}, "timeout"),
        ({"log": MotionLog(max_force=90.0), "closed": (), "lifted": (), "carried": (), "seconds": 31.0}, "collision"),
    ],
)
def test_every_other_attempt_fails_for_one_reason(changes: dict[str, object], reason: str) -> None:
    assert verdict(**changes) == reason


def test_limits_are_inclusive() -> None:
    assert verdict(log=MotionLog(max_force=LIMIT_N), seconds=LIMIT_S) == ""


def test_fingers_may_press_harder_than_the_limit() -> None:
    assert verdict(log=MotionLog(max_force=0.0, max_finger_force=500.0)) == ""


def test_two_that_lie_still_in_the_source_bin_may_have_been_touched() -> None:
    """Closing on two and lifting one is a pick; the other never left."""
    assert verdict(closed=(0, 1)) == ""


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"closed": (), "lifted": (), "carried": (), "after": after(BEFORE)}, "wrong_pose"),  # missed
        ({"lifted": (), "carried": (), "after": after(BEFORE)}, "wrong_pose"),  # slipped
        ({"carried": (), "after": after(BEFORE)}, "wrong_pose"),  # dropped
        ({"carried": (0, 1)}, "wrong_pose"),  # double_pick
        ({"log": MotionLog(max_force=99.0)}, "wrong_pose"),  # collision
        ({"seconds": 99.0}, "timeout"),  # these are not the estimate's fault
        ({"after": after("place - source place")}, "ejected"),
        ({"released": False}, "misplaced"),
        ({}, ""),  # luck is a success: the definition asks for physics only
    ],
)
def test_a_wrong_estimate_takes_the_blame_for_what_follows_from_it(changes: dict[str, object], reason: str) -> None:
    assert verdict(pose_ok=False, **changes) == reason


def test_no_evidence_is_ever_a_success_without_the_whole_definition() -> None:
    """Random attempts against the definition of docs/reference/definitions.md, written down a second time."""
    rng = np.random.default_rng(0)
    successes = 0
    for _ in range(5000):
        bins = [rng.choice(["source", "place", "-"], 3, p=[0.6, 0.3, 0.1]) for _ in range(2)]
        bins[0][0] = "source" if rng.random() < 0.8 else bins[0][0]
        held = [tuple(i for i in range(3) if rng.random() < (0.8 if i == 0 else 0.1)) for _ in range(3)]
        moving = tuple(i for i in range(3) if rng.random() < 0.1)
        e = Evidence(
            snapshot(" ".join(bins[0])),
            snapshot(" ".join(bins[1]), moving),
            *held,
            released=bool(rng.random() < 0.8),
            log=MotionLog(max_force=float(rng.exponential(20))),
            seconds=float(rng.exponential(10)),
            pose_ok=bool(rng.random() < 0.8),
        )
        left = [i for i in range(3) if bins[0][i] == "source" and bins[1][i] != "source"]
        lost = any(bins[0][i] == "place" and bins[1][i] != "place" for i in range(3))
        success = (
            len(left) == 1
            and e.carried == tuple(left)
            and len(e.closed) > 0
            and len(e.lifted) == 1
            and bins[1][left[0]] == "place"
            and left[0] not in moving
            and e.released
            and not lost
            and e.log.max_force <= LIMIT_N
            and e.seconds <= LIMIT_S
        )
        reason = judge(e, LIMIT_N, LIMIT_S)
        assert success == (reason == ""), e
        assert reason == "" or reason in set(Reason)
        successes += success
    assert 50 < successes < 2500


def test_the_nearest_true_pose_and_its_error() -> None:
    bracket = load_workpiece("bracket")
    truth = make_transform(t=np.array([[0.4, 0, 0.02], [0.5, 0, 0.02], [0.5, 0.1, 0.02]]))
    index, error, angle = nearest_true(truth[1] @ make_transform(t=(0.003, 0, -0.004)), truth, bracket)
    assert (index, angle) == (1, 0.0)
    assert error == pytest.approx(0.005)
    turned = truth[2] @ about_axis((0, 0, 1), np.array(np.pi))
    index, error, angle = nearest_true(turned, truth, bracket)
    assert index == 2
    assert error > bracket.tolerance
    assert angle == pytest.approx(np.pi)
    _, error, angle = nearest_true(turned, truth, replace(bracket, symmetry=Symmetry((0, 0, 180))))
    assert error == pytest.approx(0, abs=1e-12)
    assert angle == pytest.approx(0, abs=1e-6)
