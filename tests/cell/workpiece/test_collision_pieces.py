"""Collision pieces: boxes, cylinders and hulls rest where they should, and bad ones are named."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from pickproof.cell.errors import InputError
from pickproof.cell.frames import apply, from_rpy, invert, make_transform
from pickproof.cell.geometry.bin import table
from pickproof.cell.physics.world import World
from pickproof.cell.workpiece.collision_pieces import (
    CUTS,
    LARGE,
    CollisionBox,
    CollisionCylinder,
    CollisionHull,
    Piece,
    bounds,
    covering_boxes,
    enclosing_box,
)
from pickproof.cell.workpiece.workpiece import load_workpiece
from tests.cell.workpiece.block import write_block

CORNERS = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T / 2
BLOCK_HULL = CORNERS * (0.04, 0.03, 0.02)
RPY = (0.4, -0.7, 1.1)
PIECES: list[Piece] = [
    CollisionBox(size=(0.04, 0.03, 0.02), centre=(0.001, 0.002, 0.003), rpy=RPY),
    CollisionCylinder(radius=0.01, length=0.05, centre=(0.001, 0.002, 0.003), rpy=RPY),
    CollisionHull(apply(from_rpy((0.001, 0.002, 0.003), RPY), BLOCK_HULL)),
]
CYLINDER = {"radius": 0.01, "length": 0.02, "centre": [0, 0, 0]}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PICKPROOF_WORKPIECES", str(tmp_path))
    return tmp_path


def obj(*hulls: np.ndarray) -> str:
    lines = []
    for i, vertices in enumerate(hulls):
        lines += [f"o piece{i}", *(f"v {x} {y} {z}" for x, y, z in vertices)]
    return "\n".join(lines) + "\n"


def surface(piece: Piece) -> np.ndarray:
    if isinstance(piece, CollisionBox):
        return apply(piece.T_part_box, CORNERS * piece.size)
    if isinstance(piece, CollisionCylinder):
        turn = np.linspace(0, 2 * np.pi, 3600)
        ring = np.stack([piece.radius * np.cos(turn), piece.radius * np.sin(turn), np.zeros_like(turn)], -1)
        half = np.array([0, 0, piece.length / 2])
        return apply(piece.T_part_cylinder, np.concatenate([ring - half, ring + half]))
    return piece.vertices


@pytest.mark.parametrize("piece", PIECES, ids=lambda piece: type(piece).__name__)
def test_bounds_and_enclosing_box_are_tight(piece: Piece) -> None:
    points = surface(piece)
    low, high = bounds(piece)
    np.testing.assert_allclose([low, high], [points.min(axis=0), points.max(axis=0)], atol=1e-7)
    size, T_part_box = enclosing_box(piece)
    local = np.abs(apply(invert(T_part_box), points))
    np.testing.assert_allclose(local.max(axis=0), np.asarray(size) / 2, atol=1e-7)


def test_a_hull_without_its_margin_is_offset_on_every_face() -> None:
    inner = CollisionHull(BLOCK_HULL).without_margin(0.001)
    np.testing.assert_allclose(inner, BLOCK_HULL * (np.array([0.038, 0.028, 0.018]) / [0.04, 0.03, 0.02]), atol=1e-12)


def test_a_sharp_edge_keeps_its_margin_too() -> None:
    """Two corners 1 mm apart cannot both move 1 mm inward: what stays is a margin inside of every face, and no less."""
    wedge = CollisionHull(np.array([[x, s * w, z] for x in (-0.01, 0.01) for s in (-1, 1)
                                    for w, z in ((0.004, 0.0), (0.0002, 0.012))]))  # fmt: skip
    inner = wedge.without_margin(0.001)
    planes = ConvexHull(wedge.vertices).equations
    depth = -(inner @ planes[:, :3].T + planes[:, 3])
    assert depth.min() == pytest.approx(0.001, abs=1e-9)
    np.testing.assert_allclose(
        np.sort(depth.min(axis=0))[:-2], 0.001, atol=1e-9
    )  # all faces but the tip's two triangles
    with pytest.raises(ValueError, match="thinner"):
        CollisionHull(wedge.vertices * (1, 0.1, 1)).without_margin(0.001)


def test_boxes_around_a_large_hull_stay_near_it() -> None:
    """A held ball in one box could not be put down: its corners would go through the floor."""
    rng = np.random.default_rng(1)
    ball = rng.standard_normal((120, 3))
    hull = CollisionHull(np.array([0.025, 0.017, 0.013] * ball / np.linalg.norm(ball, axis=1, keepdims=True)))
    boxes = covering_boxes(hull)
    assert 8 <= len(boxes) <= 2**CUTS
    planes = ConvexHull(hull.vertices).equations
    weights = rng.dirichlet(np.full(120, 0.05), 2000)  # anywhere in it, corners included
    inside = np.zeros(2000, dtype=bool)
    for size, T_part_box in boxes:
        inside |= (np.abs(apply(invert(T_part_box), weights @ hull.vertices)) <= np.asarray(size) / 2 + 1e-9).all(
            axis=1
        )
        corners = apply(T_part_box, CORNERS * size)
        assert (corners @ planes[:, :3].T + planes[:, 3]).max() <= 0.75 * LARGE
    assert inside.all()
    assert sum(np.prod(size) for size, _ in boxes) < 0.8 * np.prod(enclosing_box(hull)[0])


@pytest.mark.parametrize("kind", ["boxes", "cylinders", "hulls", "hulls and a box"])
def test_every_kind_of_piece_rests_on_its_surface(folder: Path, new_world: Callable[..., World], kind: str) -> None:
    changes = {
        "boxes": {},
        "cylinders": {"collision_boxes": None, "collision_cylinders": [CYLINDER | {"radius": 0.015, "length": 0.02}]},
        "hulls": {"collision_boxes": None, "collision_hulls": "hulls.obj"},
        "hulls and a box": {"collision_hulls": "hulls.obj"},
    }[kind]
    write_block(folder, **changes)
    left, right = BLOCK_HULL * (0.5, 1, 1) - (0.01, 0, 0), BLOCK_HULL * (0.5, 1, 1) + (0.01, 0, 0)
    (folder / "block" / "hulls.obj").write_text(obj(left, right))
    block, world = load_workpiece("block"), new_world()
    world.add_box(table((1.0, 1.0, 0.1), (0.0, 0.0, 0.0)))
    for i in range(2):
        world.add_part(block, make_transform(t=(0.0, 0.0, 0.011 + 0.022 * i)))
    assert world.run_until_rest(3.0)
    # resting contacts of the engine are up to some hundredths of a millimetre deep
    np.testing.assert_allclose(world.part_poses()[:, 2, 3], [0.010, 0.030], atol=1e-4)


@pytest.mark.parametrize(
    ("field", "changes"),
    [
        ("collision_boxes.0.size.1", {"collision_boxes": [{"size": [0.04, 0.0, 0.02], "centre": [0, 0, 0]}]}),
        ("collision_boxes.0.size.0", {"collision_boxes": [{"size": [40, 30, 20], "centre": [0, 0, 0]}]}),  # [mm]
        ("collision_cylinders.0.radius", {"collision_cylinders": [CYLINDER | {"radius": -0.01}]}),
        ("collision_cylinders.1", {"collision_cylinders": [CYLINDER, CYLINDER | {"centre": [0, 0, 0.04]}]}),
        ("collision_cylinders.0.lenght", {"collision_cylinders": [CYLINDER | {"lenght": 0.01}]}),
        ("collision_hulls", {"collision_hulls": "missing.obj"}),
        ("collision_hulls", {"collision_hulls": "flat.obj"}),
        ("collision_hulls", {"collision_hulls": "thin.obj"}),
        ("collision_hulls", {"collision_hulls": "words.obj"}),
        ("collision_hulls", {"collision_hulls": "nan.obj"}),
        ("collision_hulls", {"collision_hulls": "empty.obj"}),
        ("collision_hulls", {"collision_hulls": "many.obj"}),
        ("collision_hulls.1", {"collision_hulls": "far.obj"}),
    ],
)
def test_a_bad_piece_is_named(folder: Path, field: str, changes: dict[str, object]) -> None:
    path = write_block(folder, **changes)
    ball = np.random.default_rng(0).standard_normal((400, 3))
    files = {
        "flat": obj(BLOCK_HULL * (1, 1, 0)),
        "thin": obj(BLOCK_HULL * (1, 1, 0.04)),
        "words": "v a b c\n",
        "nan": "o a\nv nan 0 0\n",
        "empty": "# nothing\n",
        "many": obj(0.01 * ball / np.linalg.norm(ball, axis=1, keepdims=True)),
        "far": obj(BLOCK_HULL, np.add(BLOCK_HULL, (0.03, 0, 0))),
    }
    for name, text in files.items():
        (folder / "block" / f"{name}.obj").write_text(text)
    with pytest.raises(InputError) as caught:
        load_workpiece("block")
    assert (caught.value.file, caught.value.field) == (str(path), field)
