"""Laws of the physics: falling, friction, frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pickproof.cell.errors import SimulationError
from pickproof.cell.frames import from_rpy, make_transform, random_rotations
from pickproof.cell.geometry.bin import Box, table
from pickproof.cell.physics.world import GRAVITY, World, engine_friction
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from tests.cell.workpiece.block import skew_mesh, write_block

NewWorld = Callable[..., World]


@pytest.fixture
def skew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Workpiece:
    """Centre of mass off the CAD origin, inertia axes turned against the CAD axes."""
    monkeypatch.setenv("PICKPROOF_WORKPIECES", str(tmp_path))
    mesh = skew_mesh()
    mesh.apply_translation(-mesh.bounds.mean(axis=0))
    write_block(tmp_path, mesh=mesh)
    part = load_workpiece("block")
    assert np.linalg.norm(part.com) > 1e-3
    off_diagonal = part.inertia - np.diag(np.diag(part.inertia))
    assert np.abs(off_diagonal).max() > 0.05 * part.inertia.max()
    return part


def test_the_pose_of_a_skew_part_goes_round(new_world: NewWorld, skew: Workpiece) -> None:
    rng = np.random.default_rng(0)
    Ts = make_transform(random_rotations(6, rng), rng.normal(size=(6, 3)))
    world = new_world()
    for T in Ts:
        world.add_part(skew, T)
    np.testing.assert_allclose(world.part_poses(), Ts, atol=1e-9)
    world.place_part(2, Ts[0])
    np.testing.assert_allclose(world.part_pose(2), Ts[0], atol=1e-9)


def test_mass_and_inertia_reach_the_engine(new_world: NewWorld, skew: Workpiece) -> None:
    world = new_world()
    world.add_part(skew, np.eye(4))
    info = world.client.getDynamicsInfo(world.parts[0], -1)
    assert info[0] == pytest.approx(skew.mass)
    np.testing.assert_allclose(sorted(info[2]), np.linalg.eigvalsh(skew.inertia), rtol=1e-9)


def test_a_spinning_part_turns_about_its_centre_of_mass(new_world: NewWorld, skew: Workpiece) -> None:
    world = new_world()
    world.client.setGravity(0, 0, 0)
    i = world.add_part(skew, np.eye(4))
    world.client.resetBaseVelocity(world.parts[i], [0, 0, 0], [0, 0, 5.0])
    world.run(0.2)
    T = world.part_pose(i)
    np.testing.assert_allclose(T[:3, :3] @ skew.com + T[:3, 3], skew.com, atol=1e-6)
    assert np.abs(T[:3, :3] - np.eye(3)).max() > 0.3


def test_a_body_falls_as_galilei_says(new_world: NewWorld, bracket: Workpiece) -> None:
    world = new_world()
    world.add_part(bracket, make_transform(t=(0.0, 0.0, 2.0)))
    world.run(0.4)
    fallen = 2.0 - world.part_pose(0)[2, 3]
    t, c, dt = 0.4, 0.04, world.dt
    exact = GRAVITY / c * (t - (1 - np.exp(-c * t)) / c)  # with linear damping c, see World.add_part
    # semi-implicit Euler takes the velocity at the end of each step: g t dt / 2 too far
    assert fallen == pytest.approx(exact + GRAVITY * t * dt / 2, rel=1e-3)


@pytest.mark.parametrize("mu", [0.2, 0.5])
@pytest.mark.parametrize(("offset_deg", "slides"), [(-3.0, False), (3.0, True)])
def test_a_part_slides_above_the_angle_of_friction(
    new_world: NewWorld, bracket: Workpiece, mu: float, offset_deg: float, slides: bool
) -> None:
    angle = np.arctan(mu) + np.deg2rad(offset_deg)
    world = new_world()
    T = from_rpy(rpy=(0.0, angle, 0.0))
    world.add_box(Box("slope", (2.0, 0.4, 0.1), T @ make_transform(t=(0.0, 0.0, -0.05))), friction=mu)
    world.add_part(replace(bracket, friction=mu), T @ make_transform(t=(-0.5, 0.0, 0.0071)))
    world.run(0.5)
    travel = np.linalg.norm(world.part_pose(0)[:3, 3] - (T @ [-0.5, 0.0, 0.0071, 1.0])[:3])
    expected = 0.5 * GRAVITY * (np.sin(angle) - mu * np.cos(angle)) * 0.5**2
    if slides:
        assert travel == pytest.approx(expected, rel=0.15)
    else:
        assert travel < 5e-4


def test_the_friction_of_a_contact_is_the_geometric_mean() -> None:
    assert engine_friction(0.5) * engine_friction(0.8) == pytest.approx(np.sqrt(0.5 * 0.8))


def test_a_part_rests_on_the_table_not_in_it(new_world: NewWorld, bracket: Workpiece) -> None:
    world = new_world()
    world.add_box(table((1.0, 1.0, 0.05), (0.0, 0.0, 0.0)))
    world.add_part(bracket, make_transform(t=(0.0, 0.0, 0.02)))
    assert world.run_until_rest(2.0)
    lowest = (bracket.vertices @ world.part_pose(0)[:3, :3].T + world.part_pose(0)[:3, 3])[:, 2].min()
    assert abs(lowest) < 5e-5


def test_boxes_have_names_and_can_be_removed(new_world: NewWorld) -> None:
    world = new_world()
    body = world.add_box(table((1.0, 1.0, 0.05), (0.0, 0.0, 0.0)))
    assert world.name_of(body) == "table"
    world.remove_box("table")
    assert world.client.getNumBodies() == 0
    with pytest.raises(KeyError):
        world.remove_box("table")


def test_a_world_gone_mad_is_an_error(new_world: NewWorld, bracket: Workpiece) -> None:
    world = new_world()
    world.add_part(bracket, np.eye(4))
    world.client.resetBaseVelocity(world.parts[0], [np.nan, 0, 0], [0, 0, 0])
    world.step()
    with pytest.raises(SimulationError, match="finite"):
        world.part_poses()
