from __future__ import annotations

import coal
import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from pickproof.cell.frames import Array, about_axis, invert, make_transform
from pickproof.cell.geometry.bin import Box
from pickproof.cell.workpiece.collision_pieces import CollisionBox, CollisionCylinder, CollisionHull, Piece, bounds
from pickproof.robots.collision.held_part import HeldPart, shapes
from pickproof.robots.collision.scene import CollisionScene
from pickproof.robots.kinematics.model import RobotModel
from tests.robots.arm_cell import T_FLANGE_TOOL
from tests.robots.collision.test_arm_collision import at


def pebble(radius: float = 0.02, seed: int = 0) -> CollisionHull:
    directions = np.random.default_rng(seed).normal(size=(60, 3))
    points = radius * directions / np.linalg.norm(directions, axis=1)[:, None] * (1.0, 0.8, 0.6)
    return CollisionHull(points[ConvexHull(points).vertices])


PIECES: tuple[Piece, ...] = (
    CollisionBox(size=(0.03, 0.02, 0.015), centre=(0.01, 0.0, 0.002), rpy=(0.3, 0.1, -0.4)),
    CollisionCylinder(radius=0.012, length=0.03, centre=(0.0, 0.01, 0.0), rpy=(0.2, 0.7, 0.0)),
    pebble(),
)


def depth_inside(piece: Piece, points: Array) -> Array:
    """How far points (n, 3) in the CAD frame lie inside the faces of a piece [m]; negative outside."""
    if isinstance(piece, CollisionHull):
        planes = ConvexHull(piece.vertices).equations
        return np.asarray(-(points @ planes[:, :3].T + planes[:, 3]).max(axis=1))
    T = piece.T_part_box if isinstance(piece, CollisionBox) else piece.T_part_cylinder
    local = points @ invert(T)[:3, :3].T + invert(T)[:3, 3]
    if isinstance(piece, CollisionBox):
        return np.asarray((np.asarray(piece.size) / 2 - np.abs(local)).min(axis=1))
    radial = piece.radius - np.linalg.norm(local[:, :2], axis=1)
    return np.minimum(radial, piece.length / 2 - np.abs(local[:, 2]))


@pytest.mark.parametrize("piece", PIECES, ids=lambda p: type(p).__name__)
@pytest.mark.parametrize("tolerance", [0.0, 0.004])
def test_a_shape_is_its_piece_smaller_by_the_tolerance(piece: Piece, tolerance: float) -> None:
    """A ball of 0.1 mm touches the shape exactly where its centre is deeper in the piece than the tolerance."""
    ((shape, T),) = shapes((piece,), tolerance)
    rng = np.random.default_rng(1)
    points = rng.uniform(*bounds(piece), (2000, 3))
    ball, request = coal.Sphere(1e-4), coal.CollisionRequest()
    place = coal.Transform3s(T.rotation, T.translation)
    touches = []
    for point in points:
        result = coal.CollisionResult()
        touches.append(coal.collide(shape, place, ball, coal.Transform3s(np.eye(3), point), request, result) > 0)
    deep = depth_inside(piece, points) - tolerance
    sure = np.abs(deep) > 3e-4
    assert sure.sum() > 1700 and 100 < np.sum(deep > 0) < 1900
    np.testing.assert_array_equal(np.array(touches)[sure], (deep > 0)[sure])


def test_a_piece_thinner_than_its_tolerance_is_left_out(robot: RobotModel) -> None:
    sheet = CollisionHull(np.asarray(trimesh.creation.box((0.03, 0.03, 0.006)).vertices))
    ((shape, T),) = shapes((sheet,), 0.005)
    shape.computeLocalAABB()
    assert max(shape.aabb_local.width(), shape.aabb_local.height(), shape.aabb_local.depth()) < 1e-3
    np.testing.assert_allclose(T.translation, 0.0, atol=1e-9)


def test_corners_enclose_the_part_where_it_is_held() -> None:
    T = make_transform(about_axis((1, 2, 3), 0.8)[:3, :3], (0.1, 0.2, 0.3))
    corners = HeldPart(PIECES, make_transform()).seen_from(T).corners
    points = np.random.default_rng(2).uniform(-0.03, 0.03, (4000, 3))
    inside = np.max([depth_inside(piece, points) for piece in PIECES], axis=0) > 0
    moved = points[inside] @ T[:3, :3].T + T[:3, 3]
    planes = ConvexHull(corners).equations
    assert inside.sum() > 200 and (moved @ planes[:, :3].T + planes[:, 3]).max() < 1e-9


def test_a_round_part_at_rest_on_the_floor_can_be_lifted(robot: RobotModel) -> None:
    """Boxes around a pebble stood 7 mm out of it: turned, it was held in the floor that it lay on, and never lifted."""
    floor = Box("floor", (0.4, 0.4, 0.02), make_transform(t=(0.45, 0.0, -0.01)))
    stone = pebble(0.03)
    scene = CollisionScene(robot, (), [floor])
    q = at(robot, 0.45, 0.0, 0.03)
    for turn in np.linspace(0.0, np.pi, 7):
        T_turn = about_axis((1.0, 0.3, 0.0), turn)
        low = float((stone.vertices @ T_turn[:3, :3].T)[:, 2].max())  # the tool looks down: its z is the depth

        def lying(height: float, T_turn: Array = T_turn, low: float = low) -> HeldPart:
            T_tool_part = make_transform(t=(0.0, 0.0, 0.03 - low - height)) @ T_turn
            return HeldPart((stone,), T_tool_part).seen_from(T_FLANGE_TOOL)

        scene.hold(lying(0.0))
        assert scene.free(q, "contact")
        scene.hold(lying(0.001))
        assert scene.free(q)
        scene.hold(lying(-0.001))
        assert not scene.free(q)
