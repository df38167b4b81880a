from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from pickproof.cell.frames import Array, apply, invert, make_transform
from pickproof.cell.geometry.bin import Box
from pickproof.robots.collision.scene import CollisionScene, HeightField, _coarse_to_fine
from pickproof.robots.kinematics.inverse import inverse
from pickproof.robots.kinematics.model import RobotModel, forward
from tests.robots.arm_cell import CELL, DOWN, PART, T_FLANGE_TOOL, TOOL

HELD = PART.seen_from(T_FLANGE_TOOL)


def at(robot: RobotModel, x: float, y: float, z: float) -> Array:
    """Joint vector of the TCP at a point, tool straight down."""
    T = make_transform(DOWN, (x, y, z)) @ invert(T_FLANGE_TOOL)
    return inverse(robot, T[None], robot.home).q[0, 0]


def test_home_and_over_the_bins_is_free(robot: RobotModel, scene: CollisionScene) -> None:
    for q in (robot.home, at(robot, 0.45, 0, 0.2), at(robot, 0.25, -0.4, 0.2)):
        assert scene.free(q)
        assert scene.first_contact(q) is None


def test_ordinary_postures_do_not_touch_themselves(robot: RobotModel) -> None:
    bare = CollisionScene(robot, TOOL, ())
    q = np.random.default_rng(0).uniform([-2.9, -0.8, -0.6, -3.0, -2.1, -6], [2.9, 1.2, 1.2, 3.0, 2.1, 6], (300, 6))
    contacts = [bare.first_contact(x) for x in q]
    assert sum(c is not None for c in contacts) < 0.06 * len(q)
    assert all("palm" in c or "finger" in c[0] for c in contacts if c)  # only the tool, folded back over the wrist


def test_the_data_sheets_ranges_are_open_and_a_folded_arm_touches_its_base(robot: RobotModel) -> None:
    bare = CollisionScene(robot, (), ())
    for posture in ([0, 0, -70, 0, 0, 0], [0, 0, -70, 90, 0, 0], [0, 0, 205, 0, 0, 0], [0, 0, 0, 0, -125, 0]):
        assert bare.first_contact(np.deg2rad(posture)) is None
    assert bare.first_contact(np.deg2rad([0, -100, 205, 0, 0, 0])) == ("base_link", "link_4")


def test_tool_through_a_wall_is_named(robot: RobotModel, scene: CollisionScene) -> None:
    contact = scene.first_contact(at(robot, 0.45 + 0.113, 0, 0.06))
    assert contact is not None
    assert contact[1] == "source_wall_x1"
    assert scene.first_contact(at(robot, 0.2, 0.3, -0.02)) is not None


def test_a_thin_wall_is_not_tunnelled(robot: RobotModel) -> None:
    """The fingers alone pass a wall of 6 mm; both ends are free, the way is not."""
    fingers = [b for b in TOOL if b.name.startswith("finger")]
    wall = Box("thin", (0.006, 0.3, 0.04), make_transform(t=(0.45, 0, 0.14)))
    scene = CollisionScene(robot, fingers, [wall])
    for y in np.linspace(-0.1, 0.1, 5):
        ends = np.stack([at(robot, 0.38, y, 0.13), at(robot, 0.52, y, 0.13)])
        assert scene.free(ends[0])
        assert scene.free(ends[1])
        assert not scene.free_path(ends)
        assert scene.path_contact(ends) in {(f.name, "thin") for f in fingers}


def test_nothing_travels_further_than_is_said(robot: RobotModel, scene: CollisionScene) -> None:
    """Between any two joint vectors of a path, no surface point of any link, tool or part; points from the geometry."""
    rng = np.random.default_rng(1)
    scene.hold(HELD)
    geometry = pin.buildGeomFromUrdf(robot.kinematics, str(robot.urdf), pin.GeometryType.COLLISION)
    data, placed = robot.kinematics.createData(), geometry.createData()
    local = []
    for shape in geometry.geometryObjects:
        shape.geometry.computeLocalAABB()
        low, high = shape.geometry.aabb_local.min_, shape.geometry.aabb_local.max_
        local.append(low + np.array(list(np.ndindex(2, 2, 2))) * (high - low))

    def surface(q: Array) -> Array:
        pin.updateGeometryPlacements(robot.kinematics, data, geometry, placed, q)
        links = [p @ T.rotation.T + T.translation for p, T in zip(local, placed.oMg, strict=True)]
        return np.concatenate([*links, apply(forward(robot, q), scene.corners)])

    for _ in range(30):
        ends = rng.uniform(robot.lower, robot.upper, (2, 6))
        ends[1] = ends[0] + 0.3 * (ends[1] - ends[0])
        knots, travel = scene._travel(ends)
        points = np.stack([surface(q) for q in knots])
        moved = np.linalg.norm(np.diff(points, axis=0), axis=-1).max(axis=1)
        assert (np.diff(travel) >= moved).all()


def test_a_path_is_blocked_where_fine_single_checks_say_so(robot: RobotModel, scene: CollisionScene) -> None:
    """The margins of the path check against checks of single configurations 0.3 mm apart, without broad phase."""
    rng, hits, agreed = np.random.default_rng(2), 0, 0
    checker = scene._checker("transit")
    for _ in range(30):
        a, b = (at(robot, *rng.uniform([0.3, -0.15, 0.05], [0.55, 0.15, 0.2])) for _ in range(2))
        _, travel = scene._travel(np.stack([a, b]))
        fine = np.linspace(a, b, int(travel[-1] / 0.3e-3) + 2)
        touches = any(
            pin.computeCollisions(checker.model, checker.data, checker.geometry, checker.geometry_data, q, True)
            for q in fine
        )
        free = scene.free_path(np.stack([a, b]))
        checker.free(a)  # the margin back to zero
        hits += touches
        assert not (free and touches)
        agreed += free != touches
    assert 2 < hits < 25
    assert agreed == 30


@pytest.mark.parametrize("n", [0, 1, 2, 3, 7, 8, 9, 64, 100])
def test_coarse_to_fine_visits_each_once(n: int) -> None:
    assert sorted(_coarse_to_fine(n)) == list(range(n))


def test_heightfield_is_not_mirrored(robot: RobotModel) -> None:
    """A tall block in one corner: only the tool over that corner touches it."""
    heights = np.full((41, 61), 0.02)
    heights[3:10, 46:60] = 0.09  # small y, large x
    field = HeightField(heights, 0.32, -0.10, 0.005)
    scene = CollisionScene(robot, TOOL, (), field)
    x0, x1, y0, y1 = 0.32 + 7 * 0.005, 0.32 + 53 * 0.005, -0.10 + 6 * 0.005, -0.10 + 34 * 0.005
    hits = {(x, y): scene.first_contact(at(robot, x, y, 0.06)) for x in (x0, x1) for y in (y0, y1)}
    assert hits.pop((x1, y0)) is not None
    assert set(hits.values()) == {None}


def test_heightfield_is_solid_and_at_its_height(robot: RobotModel) -> None:
    field = HeightField(np.full((41, 61), 0.05), 0.32, -0.10, 0.005)
    scene = CollisionScene(robot, TOOL, (), field)
    assert scene.free(at(robot, 0.45, 0, 0.051))
    assert scene.first_contact(at(robot, 0.45, 0, 0.049)) in {("finger_left", "pile"), ("finger_right", "pile")}


def test_contact_mode_lets_fingers_and_part_into_the_pile_only(robot: RobotModel, scene: CollisionScene) -> None:
    low = at(robot, 0.45, 0, 0.025)
    scene.hold(HELD)
    assert not scene.free(low, "transit")
    assert scene.free(low, "contact")
    assert not scene.free(at(robot, 0.45, 0, -0.005), "contact")  # the floor counts
    assert not scene.free(at(robot, 0.45 + 0.13, 0, 0.05), "contact")  # and the walls
    palm_deep = HeightField(np.full((100, 130), 0.12), 0.32, -0.1, 0.002)
    contact = CollisionScene(robot, TOOL, CELL, palm_deep).first_contact(low, "contact")
    assert contact == ("palm", "pile")


def test_held_part_counts_until_released(robot: RobotModel, scene: CollisionScene) -> None:
    q = at(robot, 0.45, 0.078, 0.06)  # beside the wall: the fingers fit, the 56 mm part does not
    assert scene.free(q)
    scene.hold(HELD)
    assert scene.first_contact(q) == ("held", "source_wall_y1")
    with scene.empty_handed():
        assert scene.free(q)
    assert not scene.free(q)
    scene.release()
    assert scene.free(q)


def test_the_held_part_passes_where_only_it_lay(robot: RobotModel) -> None:
    """With the pile as it is without the part, the checks are those of a scene that was scanned so; others keep it."""
    full, rest = (HeightField(np.full((41, 61), height), 0.32, -0.10, 0.005) for height in (0.05, 0.02))
    scene, fresh = CollisionScene(robot, TOOL, CELL, full), CollisionScene(robot, TOOL, CELL, rest)
    fresh.hold(HELD)
    for without, ground in ((rest, fresh), (None, scene)):
        scene.hold(HELD, without=without)
        for z in np.linspace(0.02, 0.08, 13):
            q = at(robot, 0.45, 0, z)
            assert scene.first_contact(q) == ground.first_contact(q)
            with scene.empty_handed():
                assert scene.free(q) == (z > 0.05)
    scene.hold(HELD, without=rest)
    between = at(robot, 0.45, 0, 0.045)
    assert scene.free(between)
    scene.hold(HELD)
    assert not scene.free(between)


def test_until_it_has_left_the_hand_is_as_it_waits(robot: RobotModel) -> None:
    """A post beside the fingers that only wider ones meet: they do in mode `depart`, else `transit`'s like."""
    q = at(robot, 0.45, 0, 0.05)
    wide = (TOOL[0], *(Box(b.name, b.size, make_transform(t=2 * b.T_world_box[:3, 3] * (1, 0, 0.5))) for b in TOOL[1:]))
    post = Box("post", (0.01, 0.01, 0.04), make_transform(t=(0.49, 0.0, 0.07)))
    scene = CollisionScene(robot, TOOL, [post], None, wide)
    assert scene.free(q, "transit")
    assert scene.first_contact(q, "depart") == ("finger_right", "post")
    same = CollisionScene(robot, TOOL, [post])
    assert same.free(q, "transit") and same.free(q, "depart")


def test_unseen_cells_are_refused() -> None:
    with pytest.raises(ValueError, match="finite"):
        HeightField(np.array([[0.0, np.nan], [0.0, 0.0]]), 0, 0, 0.1)
