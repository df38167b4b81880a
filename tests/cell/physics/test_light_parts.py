"""A part of any weight is held at 12 m/s2 below Coulomb's limit, and slips above it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pickproof.cell.frames import invert, make_transform
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.physics.convergence import FEWEST, MOST, solver_iterations
from pickproof.cell.physics.floating_gripper import floating_arm, floating_joints
from pickproof.cell.physics.trajectory_execution import close_jaws, execute, held_parts, wait
from pickproof.cell.physics.world import GRAVITY, World
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.scenarios.config.scenario import load_scenario
from tests.cell.physics.laws import jaw, roller
from tests.cell.workpiece.solids import block

ACCELERATION = 12.0  # [m/s2]
SECONDS = 0.1  # [s] of it: 60 mm upwards
FRICTION = 0.5
SIZES = {0.001: 0.008, 0.003: 0.01, 0.01: 0.015, 0.1: 0.03, 1.0: 0.05, 10.0: 0.05}
"""[m] across the jaws of parts of a mass in [kg]; the densest is of steel."""


def plate(mass: float) -> Workpiece:
    """As high and wide as thick, 10 kg three times."""
    across = SIZES[mass]
    side = across if mass < 10 else 3 * across
    return block((across, side, side), mass, FRICTION)


def rod_across(mass: float) -> Workpiece:
    """A rod along the tool's y axis, six times as long as thick."""
    radius = SIZES[mass] / 2
    return roller(radius, 12 * radius, mass, FRICTION)


PARTS = {"block": plate, "rod": rod_across}


def slip_in_a_lift(part: Workpiece, force: float, iterations: int | None = None) -> tuple[float, bool]:
    """How far [m] a part slides between pads of `force` [N] that accelerate upwards; and whether it stays."""
    gripper = jaw(force=force, friction=FRICTION)
    world = World(solver_iterations=iterations or solver_iterations(part, gripper))
    arm = floating_arm(world, gripper)
    T = make_transform(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, 1.0))
    arm.reset(floating_joints(T, gripper.T_flange_tool), float(part.extents[0]) + 0.002)
    world.add_part(part, T @ make_transform(t=(0.0, 0.0, -gripper.finger_size[2] / 2)))
    with world.weightless():
        close_jaws(world, arm, timeout=2.0)
        wait(world, arm, 0.05)
    gripped = invert(arm.tool_pose()) @ world.part_pose(0)
    steps = np.arange(1, round(SECONDS / world.dt) + 1) * world.dt
    up = np.zeros((len(steps), 6))
    up[:, 2] = ACCELERATION * steps**2 / 2
    execute(world, arm, arm.q + up)
    moved = invert(gripped) @ invert(arm.tool_pose()) @ world.part_pose(0)
    stays = held_parts(world, arm) == (0,)
    world.close()
    return float(np.linalg.norm(moved[:3, 3])), stays


def limit(mass: float) -> float:
    """[N] with which each pad must press."""
    return mass * (GRAVITY + ACCELERATION) / (2 * FRICTION)


@pytest.mark.parametrize("kind", PARTS)
@pytest.mark.parametrize("mass", [0.001, 0.01, 0.1, 1.0, 10.0])
def test_it_holds_below_the_limit_of_coulomb(mass: float, kind: str) -> None:
    slip, _ = slip_in_a_lift(PARTS[kind](mass), 1.25 * limit(mass))
    assert slip < 3e-4


@pytest.mark.parametrize("kind", PARTS)
@pytest.mark.parametrize("mass", [0.001, 0.01, 0.1, 1.0, 10.0])
def test_it_slips_above_the_limit_of_coulomb(mass: float, kind: str) -> None:
    """With 0.8 of the force needed, friction lacks a fifth: the part stays behind by 0.2 x 21.8 m/s2 x t^2 / 2."""
    slip, _ = slip_in_a_lift(PARTS[kind](mass), 0.8 * limit(mass))
    assert slip == pytest.approx(0.2 * (GRAVITY + ACCELERATION) * SECONDS**2 / 2, rel=0.15)


@pytest.mark.parametrize("kind", PARTS)
@pytest.mark.parametrize("mass", [0.001, 0.003, 0.01, 0.1, 1.0])
def test_it_is_held_with_the_force_of_the_data_sheet(mass: float, kind: str) -> None:
    slip, stays = slip_in_a_lift(PARTS[kind](mass), 40.0)
    assert stays and slip < 2e-4


def test_without_these_iterations_a_light_part_is_lost() -> None:
    slip, stays = slip_in_a_lift(block((0.02, 0.03, 0.03), 0.001, FRICTION), 40.0, iterations=FEWEST)
    assert not stays and slip > 0.01


def test_the_iterations_follow_from_the_masses() -> None:
    part, gripper = block((0.02, 0.03, 0.03), 0.05), load_gripper("jaw_v1")
    counts = [solver_iterations(replace(part, mass=mass), gripper) for mass in (1e-9, 0.001, 0.002, 0.01, 1.0, 10.0)]
    assert counts[0] == MOST and counts[4] == FEWEST and counts[:5] == sorted(counts[:5], reverse=True)
    assert 200 <= counts[5] <= 250
    assert counts[1] == pytest.approx(2 * counts[2], rel=0.03)
    # each sweep leaves the share (M / (m + M))^2 of the error
    assert (0.05 / 0.051) ** (2 * counts[1]) == pytest.approx(1e-7, rel=0.05)


def test_a_scenario_takes_them_where_it_does_not_say(monkeypatch: pytest.MonkeyPatch) -> None:
    assert load_scenario("bracket").physics.solver_iterations == FEWEST
    light = replace(block((0.02, 0.03, 0.03), 0.002), name="bracket")
    monkeypatch.setattr("pickproof.scenarios.config.scenario.load_workpiece", lambda name: light)
    assert load_scenario("bracket").physics.solver_iterations == solver_iterations(light, load_gripper("jaw_v1"))
    assert load_scenario("bracket", ["physics.solver_iterations=70"]).physics.solver_iterations == 70
