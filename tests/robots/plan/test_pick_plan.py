from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pickproof.cell.frames import Array, invert, make_transform
from pickproof.cell.geometry.bin import Box
from pickproof.robots.collision.scene import CollisionScene
from pickproof.robots.failure import Cause, PlanFailure, Refusal, Stage
from pickproof.robots.kinematics.inverse import FRONT, branch, inverse
from pickproof.robots.kinematics.model import RobotModel, forward
from pickproof.robots.motion.blended_motion import OFF_LINE
from pickproof.robots.motion.dynamics import Load
from pickproof.robots.motion.trajectory import Trajectory
from pickproof.robots.plan.path_search import search
from pickproof.robots.plan.pick_plan import PickPlan, PickRequest, check_grasps, plan_pick
from pickproof.robots.plan.pick_stops import UP
from tests.robots.arm_cell import CELL, DOWN, T_FLANGE_TOOL, TOOL, changed, request_at, share_of_limits, tilted
from tests.robots.motion.test_trajectory import assert_at_rest, assert_keeps_limits

pytestmark = pytest.mark.slow

TOLERANCE = OFF_LINE + 0.1e-3  # [m]
WALL = Box("wall", (0.5, 0.006, 0.45), make_transform(t=(0.4, -0.2, 0.225)))


def tool(robot: RobotModel, q: Array) -> Array:
    return forward(robot, q) @ T_FLANGE_TOOL


def assert_carries_out(scene: CollisionScene, request: PickRequest, plan: PickPlan) -> None:
    """The laws of every plan: joined up, within limits, free all along, at the poses asked for."""
    robot = scene.robot
    motions = [plan.approach, joined(plan.lift, plan.carry)]
    motions += [plan.leave] if len(plan.leave.q) > 1 else []
    for trajectory in motions:
        assert_keeps_limits(robot, trajectory)
        assert_at_rest(trajectory)
    for a, b in ((plan.approach, plan.lift), (plan.carry, plan.leave)):
        np.testing.assert_allclose(a.q[-1], b.q[0], atol=1e-9)
        np.testing.assert_allclose(a.qd[-1], b.qd[0], atol=1e-9)
    np.testing.assert_allclose(plan.approach.q[0], request.q_start, atol=1e-12)
    q_end = plan.carry.q[-1] if request.q_end is None else request.q_end
    np.testing.assert_allclose(plan.leave.q[-1], q_end, atol=1e-12)
    grasp, place = request.T_base_tool_grasp, request.places.Ts_base_tool[plan.place]
    np.testing.assert_allclose(tool(robot, plan.approach.q[-1]), grasp, atol=1e-6)
    np.testing.assert_allclose(tool(robot, plan.carry.q[-1]), place, atol=1e-6)
    for q in (plan.approach.q[-1], plan.carry.q[-1]):
        assert int(branch(robot, q)) == plan.branch in FRONT

    straight = request.lines.straight or 0.05  # where the whole line is kept; at its very end the way on begins
    down = grasp[:3, 2]
    into = tool(robot, plan.approach.q)[:, :3, 3] - grasp[:3, 3]
    assert off_line(into, -down, min(straight, request.lines.approach)) < TOLERANCE
    out = tool(robot, plan.lift.q)[:, :3, 3] - grasp[:3, 3]
    assert off_line(out, np.array(request.lines.retract_direction), min(straight, request.lines.retract)) < TOLERANCE
    onto = tool(robot, plan.carry.q)[:, :3, 3] - place[:3, 3]
    assert off_line(onto, UP, min(straight, request.lines.place)) < TOLERANCE

    assert scene.path_contact(plan.approach.q, "contact") is None
    before_line = np.linalg.norm(into, axis=1) > request.lines.approach
    assert scene.path_contact(plan.approach.q[before_line]) is None
    assert scene.path_contact(plan.leave.q) is None
    scene.hold(request.part.held.seen_from(T_FLANGE_TOOL), request.part.tolerance)
    assert scene.path_contact(plan.lift.q, "contact") is None
    assert scene.path_contact(plan.carry.q) is None
    scene.release()

    points = tool(robot, motions[1].q)[:-1, :3, 3]
    acceleration = np.linalg.norm(np.diff(points, 2, axis=0), axis=1) / plan.carry.dt**2
    assert acceleration.max() <= 1.05 * request.limits.carry_acceleration


def joined(first: Trajectory, second: Trajectory) -> Trajectory:
    """As the arm executes them, sample after sample: one that stood in both would stop the part dead for a step."""
    q, qd = (np.concatenate([a, b]) for a, b in ((first.q, second.q), (first.qd, second.qd)))
    return Trajectory("both", q, qd, first.dt)


def off_line(points: Array, way: Array, length: float) -> float:
    """How far points (n, 3) within `length` of the origin are from the line along `way` in [m]."""
    near = points[np.linalg.norm(points, axis=1) < length - 1e-6]
    assert len(near) > 5
    return float(np.linalg.norm(near - (near @ way)[:, None] * way, axis=1).max())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("x", "y", "R"), [(0.45, 0.0, DOWN), (0.42, 0.03, tilted(20, 60, 30)), (0.47, -0.02, tilted(20, 200, 100))]
)
def test_a_pick_from_home_to_home(robot: RobotModel, scene: CollisionScene, x: float, y: float, R: Array) -> None:
    request = request_at(robot, x, y, R)
    plan = plan_pick(scene, request)
    assert isinstance(plan, PickPlan), plan
    assert_carries_out(scene, request, plan)
    assert scene.held is None


def test_a_part_at_a_high_wall_is_lifted_out_before_it_turns_away(robot: RobotModel) -> None:
    """A first line of 6 cm ends beside the wall, where the part cannot turn; the longer one ends above it."""
    wall = Box("wall", (0.006, 0.30, 0.14), make_transform(t=(0.45 - 0.0125, 0.0, 0.07)))
    thin = tuple(b for b in TOOL if b.name != "palm")
    request = changed(
        request_at(robot, 0.45, 0.0), q_end=None, lines={"retract": 0.06, "straight": 0.012}, search={"allowed": False}
    )
    short = plan_pick(CollisionScene(robot, thin, [*CELL, wall]), request)
    assert isinstance(short, PlanFailure) and short.stage == Stage.CARRY, short
    scene = CollisionScene(robot, thin, [*CELL, wall])
    plan = plan_pick(scene, changed(request, lines={"out_of_bin": 0.13}))
    assert isinstance(plan, PickPlan), plan
    assert_carries_out(scene, request, plan)
    unbound = plan_pick(CollisionScene(robot, thin, CELL), changed(request, lines={"out_of_bin": 0.13}))
    assert isinstance(unbound, PickPlan) and unbound.carry.duration < plan.carry.duration  # not longer than need be


def test_picks_one_after_the_other_without_going_home(robot: RobotModel, scene: CollisionScene) -> None:
    """The arm waits where it let the part go; the next pick leaves that place straight up and may round its lines."""
    request = changed(request_at(robot, 0.45, 0.0), q_end=None, lines={"straight": 0.02})
    first = plan_pick(scene, request)
    assert isinstance(first, PickPlan), first
    assert_carries_out(scene, request, first)
    assert len(first.leave.q) == 1
    assert first.cleared == 0
    waits = first.carry.q[-1]
    request = changed(
        request_at(robot, 0.41, 0.03, tilted(20, 60, 30)), q_start=waits, q_end=None, lines={"straight": 0.02}
    )
    request = changed(request, lines={"depart": 0.08})
    second = plan_pick(scene, request)
    assert isinstance(second, PickPlan), second
    assert_carries_out(scene, request, second)
    away = tool(robot, second.approach.q)[:, :3, 3] - tool(robot, waits)[:3, 3]
    assert off_line(away, UP, 0.02) < TOLERANCE
    assert np.linalg.norm(away[second.cleared]) >= 0.08
    assert np.linalg.norm(away[second.cleared - 1]) < 0.08
    whole = plan_pick(scene, changed(request, lines={"straight": None}))
    assert isinstance(whole, PickPlan)
    assert second.duration < 0.9 * whole.duration


def test_of_places_equally_wanted_the_quickest_is_used(robot: RobotModel, scene: CollisionScene) -> None:
    request = request_at(robot, 0.45, 0.0)
    plans = [plan_pick(scene, changed(request, places={"rank": rank})) for rank in (None, (0, 0, 0), (1, 1, 0))]
    carried = [p.lift.duration + p.carry.duration for p in plans if isinstance(p, PickPlan)]
    places = [p.place for p in plans if isinstance(p, PickPlan)]
    assert places[0] == 0
    assert places[1:] == [2, 2]  # the nearest to the source bin
    assert carried[1] < carried[0]


def test_the_first_free_place_is_used(robot: RobotModel) -> None:
    request = request_at(robot, 0.45, 0.0)
    taken = Box("taken", (0.05, 0.08, 0.05), make_transform(t=(0.25, -0.40, 0.035)))
    plan = plan_pick(CollisionScene(robot, TOOL, [*CELL, taken]), request)
    assert isinstance(plan, PickPlan)
    assert plan.place == 1


def test_the_same_request_gives_the_same_plan(robot: RobotModel) -> None:
    """Bit for bit, also when a search is needed, and whatever ran before."""
    request = request_at(robot, 0.45, 0.0)
    plans = []
    for k in range(2):
        scene = CollisionScene(robot, TOOL, [*CELL, WALL])
        if k:
            search(scene, robot.home, robot.home + 0.3, seed=99)
        plan = plan_pick(scene, request)
        assert isinstance(plan, PickPlan)
        plans.append(plan)
    assert "search" in plans[0].methods
    for a, b in zip(plans[0].trajectories, plans[1].trajectories, strict=True):
        np.testing.assert_array_equal(a.q, b.q)
        np.testing.assert_array_equal(a.qd, b.qd)
    assert_carries_out(CollisionScene(robot, TOOL, [*CELL, WALL]), request, plans[0])


def test_another_seed_gives_another_way_around_the_wall(robot: RobotModel) -> None:
    scene = CollisionScene(robot, TOOL, [*CELL, WALL])
    ends = robot.home, forward_to(robot)
    a, b = (search(scene, *ends, seed=s) for s in (1, 2))
    assert a is not None
    assert b is not None
    assert not np.array_equal(a, b)


def forward_to(robot: RobotModel) -> Array:
    """A joint vector over the source bin, behind the wall as seen from home."""
    plan = plan_pick(CollisionScene(robot, TOOL, ()), request_at(robot, 0.45, 0.0))
    assert isinstance(plan, PickPlan)
    return plan.lift.q[-1]


def failure(scene: CollisionScene, request: PickRequest) -> PlanFailure:
    plan = plan_pick(scene, request)
    assert isinstance(plan, PlanFailure)
    return plan


def test_every_failure_names_its_reason(robot: RobotModel, scene: CollisionScene) -> None:
    base = request_at(robot, 0.45, 0.0)
    far_away = failure(scene, request_at(robot, 1.1, 0.0))
    assert far_away == PlanFailure(Stage.GRASP, Refusal(Cause.OUT_OF_REACH), "grasp")
    assert str(far_away) == "unreachable: grasp: out of reach"
    at_wall = failure(scene, request_at(robot, 0.45 + 0.113, 0.0, z=0.05))
    assert (at_wall.stage, at_wall.cause, at_wall.reason) == (Stage.GRASP, Cause.COLLISION, "no_path")
    assert at_wall.refusal.contact is not None and at_wall.refusal.contact[1] == "source_wall_x1"
    lid = Box("lid", (0.26, 0.20, 0.01), make_transform(t=(0.45, 0, 0.13)))
    covered = failure(CollisionScene(robot, TOOL, [*CELL, lid]), base)
    assert covered.reason == "no_path"
    assert "lid" in covered.detail
    far = failure(scene, changed(base, lines={"retract": 0.6}))
    assert far.stage == Stage.LIFT_LINE
    assert far.detail.startswith("lift line: ")
    none = failure(scene, changed(base, places={"Ts_base_tool": np.zeros((0, 4, 4))}))
    assert (none.stage, none.cause) == (Stage.PLACE, Cause.NO_PLACE)
    deep = failure(scene, changed(base, places={"Ts_base_tool": make_transform(DOWN, [[0.25, -0.4, -0.05]])}))
    assert deep.reason == "no_path"
    assert (deep.stage, deep.where) == (Stage.PLACE, "place pose 0")


def test_a_blocked_start_says_by_what(robot: RobotModel) -> None:
    post = Box("post", (0.06, 0.06, 0.1), make_transform(t=tool(robot, robot.home)[:3, 3] - [0, 0, 0.03]))
    blocked = failure(CollisionScene(robot, TOOL, [*CELL, post]), request_at(robot, 0.45, 0.0))
    assert blocked.reason == "no_path"
    assert blocked.detail.startswith("way to the grasp: ")
    assert blocked.detail.endswith("touches post")


def test_grasps_are_checked_one_at_a_time(robot: RobotModel, scene: CollisionScene) -> None:
    Ts = make_transform(DOWN, np.array([[0.45, 0, 0.035], [1.1, 0, 0.035], [0.563, 0, 0.05]]))
    free, far, wall = check_grasps(scene, Ts, T_FLANGE_TOOL)
    assert free is None
    assert far is not None
    assert far.reason == "unreachable"
    assert wall is not None
    assert wall.reason == "no_path"
    assert next(check_grasps(scene, Ts, T_FLANGE_TOOL)) is None


def view_slices() -> list[Box]:
    """The pyramid from the camera to the source bin's rim, 5 cm wider all round."""
    camera, rim = np.array([0.45, 0.0, 0.85]), np.array([0.13 + 0.05, 0.10 + 0.05])
    slices = []
    for z in np.arange(0.01, 0.85, 0.02):
        half = rim * (camera[2] - z) / (camera[2] - 0.09) if z > 0.09 else rim
        slices.append(Box("view", (2 * half[0], 2 * half[1], 0.02), make_transform(t=(*camera[:2], z))))
    return slices


def test_home_leaves_the_cameras_view_free(robot: RobotModel) -> None:
    assert CollisionScene(robot, TOOL, view_slices()).first_contact(robot.home) is None


def test_waiting_at_a_place_leaves_the_cameras_view_free(robot: RobotModel) -> None:
    """At every place over the place bin of the bracket's scenario, tool down or leaning, in either branch."""
    scene, rng, seen = CollisionScene(robot, TOOL, view_slices()), np.random.default_rng(0), 0
    points = np.array([0.16, -0.43, 0.03]) + rng.uniform([-0.18, -0.13, 0.0], [0.18, 0.13, 0.08], (150, 3))
    R = np.stack([tilted(rng.uniform(0, 45), *rng.uniform(0, 360, 2)) for _ in points])
    found = inverse(robot, make_transform(R, points) @ invert(T_FLANGE_TOOL))
    for slot in FRONT:
        for q in found.q[found.valid[:, slot], slot]:
            assert scene.first_contact(q) is None
            seen += 1
    assert seen > 150


def test_a_heavy_part_is_carried_slower_and_one_too_heavy_not_at_all(robot: RobotModel, scene: CollisionScene) -> None:
    """Motors as weak as the planner may assume: the torques of the plan by themselves, at every sample."""
    weak = replace(robot, effort=robot.effort * (0.25, 0.25, 0.25, 0.1, 0.1, 0.1))
    scene.robot = weak
    request = changed(request_at(robot, 0.45, 0.0), hand={"load": Load(0.7, np.array([0.0, 0.0, 0.06]))})
    seconds = []
    for mass in (0.1, 2.0):
        part = Load(mass, np.array([0.0, 0.0, 0.16]))
        plan = plan_pick(scene, changed(request, part={"load": part}, limits={"carry_acceleration": 40.0}))
        assert isinstance(plan, PickPlan), plan
        both = joined(plan.lift, plan.carry)
        assert (share_of_limits(weak, both, request.hand.load + part) < 1.01).all()
        seconds.append(both.duration)
    assert seconds[1] > 1.02 * seconds[0]
    refused = failure(scene, changed(request, part={"load": Load(60.0, np.array([0.0, 0.0, 0.16]))}))
    assert (refused.cause, refused.reason) == (Cause.TORQUE, "unreachable")
