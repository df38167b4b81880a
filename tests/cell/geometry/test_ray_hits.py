"""Laws of exact hits: the distance is that of the plane, and an edge belongs to one triangle whoever found it."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pickproof.cell.geometry.ray_hits import as_rays, exact_hits, facing
from pickproof.cell.geometry.raycast import EmbreexCaster, Open3dCaster
from pickproof.cell.workpiece.workpiece import Workpiece


def square() -> tuple[np.ndarray, np.ndarray]:
    """Two triangles with the diagonal from (0, 0) to (1, 1) in common."""
    return np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]])


@pytest.mark.slow
def test_an_edge_belongs_to_the_same_triangle_whichever_was_found() -> None:
    rng = np.random.default_rng(0)
    where = rng.uniform(0.1, 0.9, 2000)
    off = rng.uniform(-1e-7, 1e-7, 2000)  # within the rounding of float32
    off[:200] = 0.0
    ends = np.stack([where + off, where - off, np.zeros(2000)], axis=1)
    origins = np.array([[0.3, 0.4, 1.7]])
    vertices, faces = square()
    answers = [exact_hits(vertices, faces, *as_rays(origins, ends - origins), np.full(2000, found)) for found in (0, 1)]
    np.testing.assert_array_equal(answers[0][1], answers[1][1])
    np.testing.assert_array_equal(answers[0][0], answers[1][0])
    np.testing.assert_array_equal(answers[0][1][200:], np.where(off[200:] > 0, 0, 1))
    np.testing.assert_allclose(answers[0][0], 1.0, rtol=1e-14)


def test_a_triangle_that_is_hit_inside_keeps_its_ray_and_a_miss_stays_one() -> None:
    vertices, faces = square()
    rays = as_rays(np.array([0.0, 0.0, 2.0]), np.array([[0.8, 0.2, -2.0], [0.8, 0.2, -2.0]]))
    t, face = exact_hits(vertices, faces, *rays, np.array([0, -1]))
    np.testing.assert_allclose(t, [1.0, np.inf])
    assert face.tolist() == [0, -1]


@pytest.mark.slow
def test_both_ray_casters_agree_to_the_last_bit(bracket: Workpiece) -> None:
    """Their Embree is of another version and kernel; where both hit, triangle, distance and normal are the same."""
    rng = np.random.default_rng(1)
    origins = rng.normal(size=(20_000, 3))
    origins *= 0.4 / np.linalg.norm(origins, axis=1, keepdims=True)
    targets = bracket.vertices[rng.integers(len(bracket.vertices), size=len(origins))]
    targets[::2] = rng.uniform(-0.02, 0.02, (len(origins[::2]), 3))  # half aim at vertices, where many edges meet
    casters = [make(bracket.vertices, bracket.faces) for make in (Open3dCaster, EmbreexCaster)]
    one, two = (caster.cast(origins, targets - origins) for caster in casters)
    both = (one.face >= 0) & (two.face >= 0)
    assert both.sum() > 8000
    np.testing.assert_array_equal(one.face[both], two.face[both])
    np.testing.assert_array_equal(one.t[both], two.t[both])


def test_normals_stand_against_the_rays() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)
    directions = np.random.default_rng(2).normal(size=(500, 3))
    face = np.arange(500)
    normals, cosine = facing(np.asarray(ball.vertices), np.asarray(ball.faces), face, directions)
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    np.testing.assert_allclose(np.abs((normals * np.asarray(ball.face_normals)[face]).sum(1)), 1.0, rtol=1e-9)
    np.testing.assert_allclose(-(normals * unit).sum(1), cosine, atol=1e-12)
    assert (cosine >= 0).all()
    nothing = facing(np.asarray(ball.vertices), np.asarray(ball.faces), np.array([-1]), directions[:1])
    assert not nothing[0].any() and not nothing[1].any()
