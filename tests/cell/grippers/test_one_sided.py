"""Cups and magnets: where they seal or stick, and that they lose a workpiece at the load of the closed form."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from pickproof.cell.frames import Array, about_axis, invert
from pickproof.cell.grippers.magnet import Magnet
from pickproof.cell.grippers.one_sided import TOUCH
from pickproof.cell.grippers.one_sided_hold import Hold, share
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.grippers.vacuum import OUTSIDE, VacuumGripper
from pickproof.cell.physics.contact_probe import probe_part
from pickproof.cell.physics.world import GRAVITY
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from tests.cell.grippers.one_sided_cell import OneSidedCell
from tests.cell.workpiece.solids import block, drilled, ribbed, rod, turned

NewCell = Callable[..., OneSidedCell]
PLATE = block((0.06, 0.06, 0.02), 0.3)
WEIGHT = 0.3 * GRAVITY


@pytest.fixture
def new_cell() -> Iterator[NewCell]:
    cells: list[OneSidedCell] = []

    def make(*args: object, **options: object) -> OneSidedCell:
        cells.append(OneSidedCell.build(*args, **options))  # type: ignore[arg-type]
        return cells[-1]

    yield make
    for cell in cells:
        cell.world.close()


@pytest.fixture(scope="module")
def cup() -> VacuumGripper:
    gripper = load_gripper("cup_20")
    assert isinstance(gripper, VacuumGripper)
    return gripper


@pytest.fixture(scope="module")
def magnet() -> Magnet:
    gripper = load_gripper("magnet_20")
    assert isinstance(gripper, Magnet)
    return gripper


def test_loads_on_several_cups_are_in_balance_with_the_load_on_all() -> None:
    rng = np.random.default_rng(0)
    holds = [Hold((x, y), 0.02, 50.0, 0.5, 0.01, 0.02) for x, y in rng.uniform(-0.2, 0.2, (4, 2))]
    force, moment = rng.normal(size=3), rng.normal(size=3)
    loads = share(force, moment, holds)
    at = np.array([[*h.centre, 0.0] for h in holds])
    np.testing.assert_allclose(loads[:, :3].sum(0), force, atol=1e-9)
    np.testing.assert_allclose((loads[:, 3:] + np.cross(at, loads[:, :3])).sum(0), moment, atol=1e-9)


def test_a_bar_shares_a_moment_by_the_lever_rule() -> None:
    """Two cups 0.4 m apart: M / d each, but for the little that their lips take in bending."""
    holds = [Hold((0.0, y), 0.02, 50.0, 0.5, 0.01, 0.02) for y in (-0.2, 0.2)]
    loads = share(np.array([0.0, 0.0, 10.0]), np.array([4.0, 0.0, 0.0]), holds)
    np.testing.assert_allclose(loads[:, 2], [5 - 4 / 0.4, 5 + 4 / 0.4], rtol=0.01)


@pytest.mark.parametrize(
    ("limit", "force", "moment"),
    [
        ("normal", (0, 0, -1), (0, 0, 0)),
        ("shear", (0.6, 0.8, 0), (0, 0, 0)),
        ("moment", (0, 0, 0), (0.6, 0.8, 0)),
        ("shear", (0, 0, 0), (0, 0, 1)),  # torsion is carried by the same friction
    ],
)
def test_a_cup_lets_go_at_its_limit(
    new_cell: NewCell, cup: VacuumGripper, limit: str, force: Array, moment: Array
) -> None:
    """p A and, with what is left of it under the weight, mu (p A - W), (p A - W) r / 2 and mu (p A - W) r."""
    rest = cup.pressure * np.pi * cup.effective_diameter**2 / 4 - WEIGHT
    r, mu = cup.diameter / 2, cup.friction
    expected = {"normal": rest, "shear": mu * rest * (r if any(moment) else 1.0), "moment": rest * r / 2}[limit]
    cell = new_cell(cup, PLATE)
    assert cell.held and cell.grip.faces == ("",)
    assert cell.pull(np.array(force), np.array(moment), rate=2 * expected, limit=2 * expected) == pytest.approx(
        expected, rel=0.02
    )
    assert cell.arm.connections[0].lost == [limit]
    z = cell.world.part_pose(0)[2, 3]
    cell.world.run(0.1)
    assert cell.world.part_pose(0)[2, 3] < z - 0.03  # it falls, nothing else holds it


@pytest.mark.parametrize("kind", ["cup_20", "magnet_20"])
@pytest.mark.parametrize(("share_of_limit", "holds"), [(0.97, True), (1.03, False)])
def test_a_workpiece_just_under_the_limit_stays(
    new_cell: NewCell, kind: str, share_of_limit: float, holds: bool
) -> None:
    gripper = load_gripper(kind)
    cell = new_cell(gripper, PLATE)
    most = gripper.force if isinstance(gripper, VacuumGripper) else gripper.pull(cell.gap)
    assert cell.carry(share_of_limit * most - WEIGHT, np.array([0, 0, -1.0]), np.zeros(3)) == holds


@pytest.mark.parametrize("cover", [0.0, 0.0003, 0.001, 0.002])
def test_a_magnet_loses_force_with_the_gap(new_cell: NewCell, magnet: Magnet, cover: float) -> None:
    """F0 / (1 + g / g0)^2; at 2 mm it is less than the weight."""
    cell = new_cell(replace(magnet, cover=cover), PLATE, gap=0.0001)
    expected = magnet.force / (1 + (cell.gap + cover) / magnet.gap_scale) ** 2
    if expected < WEIGHT:
        assert not cell.held
    else:
        pulled = WEIGHT + cell.pull(np.array([0, 0, -1.0]), np.zeros(3), 2 * expected, 100.0)
        assert pulled == pytest.approx(expected, rel=0.03)


def test_a_magnet_holds_by_the_area_it_touches(new_cell: NewCell, magnet: Magnet) -> None:
    """A rib of 8 mm under a face of 20 mm: the plate, 5 mm below it, adds nearly nothing."""
    cell = new_cell(magnet, ribbed((0.06, 0.06, 0.01), 0.1, 0.008, 0.005), gap=0.0)
    (hold,) = cell.arm.connections[0].holds
    r, half = 0.010, 0.004
    strip = 2 * (half * np.sqrt(r**2 - half**2) + r**2 * np.arcsin(half / r)) / (np.pi * r**2)
    expected = magnet.force * (strip + (1 - strip) / (1 + 0.005 / magnet.gap_scale) ** 2)
    assert hold.force == pytest.approx(expected, rel=0.03)


def test_a_magnet_does_not_hold_aluminium(new_cell: NewCell, magnet: Magnet) -> None:
    cell = new_cell(magnet, replace(PLATE, magnetic=False))
    assert not cell.held and cell.grip.faces == ("not_magnetic",)


@pytest.mark.parametrize(
    ("workpiece", "options", "verdict"),
    [
        (PLATE, {}, ""),
        (PLATE, {"gap": 0.0015}, "no_contact"),
        (PLATE, {"offset": (0.019, 0.0)}, ""),
        (PLATE, {"offset": (0.021, 0.0)}, "edge"),
        (PLATE, {"tilt": np.deg2rad(14)}, ""),
        (PLATE, {"tilt": np.deg2rad(16)}, "tilted"),
        (drilled((0.06, 0.06, 0.003), 0.1, 0.004, 0.008), {}, "leaking"),
        (ribbed((0.06, 0.06, 0.01), 0.1, 0.005, 0.002), {}, "uneven"),
    ],
)
def test_a_cup_seals_where_its_lip_can(
    new_cell: NewCell, cup: VacuumGripper, workpiece: Workpiece, options: dict[str, object], verdict: str
) -> None:
    cell = new_cell(cup, workpiece, **options)
    assert cell.grip.faces == (verdict,)
    assert bool(cell.grip.parts) == (verdict == "")


@pytest.mark.parametrize(("share_of_radius", "seals"), [(0.95, False), (1.05, True)])
def test_a_lip_follows_a_cylinder_down_to_a_radius(
    new_cell: NewCell, cup: VacuumGripper, share_of_radius: float, seals: bool
) -> None:
    """A rim of radius a on a cylinder sinks by R - sqrt(R^2 - a^2) at its sides: the flatness allows R = a^2/2f + f/2.

    Its normals lean there by asin(a / R), which at 15 degrees allows less curvature than the flatness does here.
    """
    a, f = cup.radius + 0.0005, cup.flatness
    radius = share_of_radius * max(a**2 / (2 * f) + f / 2, a / np.sin(np.deg2rad(cup.normal_deg)))
    cell = new_cell(cup, rod(radius, 0.08, 0.2), gap=0.0)
    assert cell.held == seals


@pytest.mark.slow
def test_a_bar_of_cups_carries_the_long_profile_and_seals_beside_its_slots_only(new_cell: NewCell) -> None:
    bar, profile = load_gripper("cup_bar"), load_workpiece("ps6d_23")
    along = turned(profile)
    cell = new_cell(bar, along, gap=0.0)
    assert cell.grip.faces == ("", "", "", "") and cell.held
    weight = profile.mass * GRAVITY
    assert cell.arm.connections[0].load[2] == pytest.approx(weight, rel=0.01)
    pulled = weight + cell.pull(np.array([0, 0, -1.0]), np.zeros(3), 400.0, 400.0)
    assert pulled == pytest.approx(4 * bar.force, rel=0.02)  # type: ignore[union-attr]
    slot = new_cell(bar, along, offset=(0.0, 0.20), gap=0.0)  # three cups come over slots
    assert sorted(slot.grip.faces) == ["", "edge", "edge", "edge"]


@pytest.mark.parametrize("sprung_alone", [False, True])
def test_cups_on_springs_of_their_own_reach_as_far_down_as_the_bar_is_pressed(
    cup: VacuumGripper, sprung_alone: bool
) -> None:
    """A plate leans by a under two cups d apart and touches the upper lip: the lower one is d tan a over it."""
    apart, lean = 0.2, np.deg2rad(1.5)
    bar = replace(cup, centres=((-apart / 2, 0.0), (apart / 2, 0.0)), sprung_alone=sprung_alone)
    T_tool_part = about_axis((0.0, 1.0, 0.0), np.array(-lean))
    to_edge = apart / 2 + bar.radius + OUTSIDE  # of the upper lip from the middle of the bar
    T_tool_part[:3, 3] = (-to_edge, 0.0, 0.0) + T_tool_part[:3, :3] @ (to_edge, 0.0, 0.01)
    plate, T_part_tool = block((0.4, 0.06, 0.02), 1.0), invert(T_tool_part)
    wanted = apart * np.tan(lean) - TOUCH
    for pressed in (0.0, 0.95 * wanted, 1.05 * wanted):
        seals = bar.take(lambda xy: probe_part(plate, T_part_tool, xy), lambda _: False, pressed)[1]
        assert seals == ("", "" if sprung_alone and pressed > wanted else "no_contact")
