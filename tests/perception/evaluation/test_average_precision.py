"""Average precision against numbers worked out by hand."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from pickproof.cell.frames import about_axis, apply, make_transform, random_rotations
from pickproof.cell.sensing.camera import render
from pickproof.cell.symmetry.symmetry import Symmetry
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.perception.evaluation.average_precision import (
    Detections,
    ap_mssd,
    ap_sileane,
    diameter,
    mssd,
    pose_distances,
    unoccluded_pixels,
    visible_share,
)
from tests.perception import artificial

BRACKET = load_workpiece("bracket")


def workpiece(mesh, *degrees):
    return replace(
        BRACKET, vertices=np.asarray(mesh.vertices), faces=np.asarray(mesh.faces), symmetry=Symmetry(degrees)
    )


BLOCK = trimesh.creation.box((0.06, 0.03, 0.02))  # diameter 70 mm, so 7 mm is right in Bregier's sense
PLAIN = workpiece(BLOCK, 0, 0, 0)
ROD = trimesh.creation.cylinder(0.01, 0.06, sections=72)


def at(*x):
    """Poses side by side, turned like the CAD, at x in [m]."""
    return make_transform(t=np.stack([x, np.zeros(len(x)), np.ones(len(x))], axis=-1))


def frame(predicted, scores, true, visible=None):
    return Detections(predicted, np.asarray(scores), true, np.ones(len(true)) if visible is None else visible)


NOTHING = frame(np.zeros((0, 4, 4)), np.zeros(0), at(0.0, 0.2))


def test_diameter_of_a_block_is_its_diagonal():
    assert diameter(PLAIN) == pytest.approx(0.07)


def test_distance_is_the_mean_square_of_the_surface():
    Ts = make_transform(random_rotations(2, np.random.default_rng(0)), [(0, 0, 0), (0.01, 0.02, 0)])
    points = BRACKET.sample_surface(50_000)[0]
    expected = np.sqrt(((apply(Ts[0], points) - apply(Ts[1], points)) ** 2).sum(1).mean())
    assert pose_distances(Ts[:1], Ts[1:], BRACKET)[0, 0] == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("degrees", [(0, 0, 180), (180, 180, 180)])
def test_distance_at_the_best_of_a_finite_group(degrees):
    block = workpiece(BLOCK, *degrees)
    Ts = make_transform(random_rotations(2, np.random.default_rng(1)), [(0, 0, 0), (0.01, 0.02, 0)])
    turned = Ts[1] @ make_transform(block.symmetry.S)
    assert pose_distances(Ts[:1], Ts[1:], block)[0, 0] == pytest.approx(pose_distances(Ts[:1], turned, PLAIN).min())
    assert np.allclose(pose_distances(Ts[1:], turned, block), 0, atol=1e-9)


@pytest.mark.parametrize("degrees", [(0, 0, 5), (180, 180, 5)])
def test_distance_at_the_best_turn_about_an_axis_of_revolution(degrees):
    rod = workpiece(ROD, *degrees)
    Ts = make_transform(random_rotations(2, np.random.default_rng(2)), [(0, 0, 0), (0.01, 0.02, 0)])
    turned = Ts[1] @ make_transform(rod.symmetry.rotations(720))
    least = pose_distances(Ts[:1], turned, workpiece(ROD, 0, 0, 0)).min()
    assert pose_distances(Ts[:1], Ts[1:], rod)[0, 0] == pytest.approx(least, rel=1e-3)


def test_distance_of_spheres_is_that_of_centres():
    ball = workpiece(trimesh.creation.icosphere(radius=0.02), 1, 1, 1)
    Ts = make_transform(random_rotations(2, np.random.default_rng(3)), [(0, 0, 0), (0.003, 0.004, 0)])
    assert pose_distances(Ts[:1], Ts[1:], ball)[0, 0] == pytest.approx(0.005)
    assert mssd(Ts[0], Ts[1:], ball)[0] == pytest.approx(0.005)


def test_mssd_is_that_of_the_farthest_corner_at_the_best_symmetry():
    shifted = at(0.003)[0]
    assert mssd(shifted, at(0.0), PLAIN)[0] == pytest.approx(0.003)
    half_turn = at(0.0)[0] @ about_axis((0, 0, 1), np.pi)
    assert mssd(half_turn, at(0.0), PLAIN)[0] == pytest.approx(2 * np.hypot(0.03, 0.015))
    assert mssd(half_turn, at(0.0), workpiece(BLOCK, 0, 0, 180))[0] == pytest.approx(0, abs=1e-12)
    rod = workpiece(ROD, 0, 0, 5)
    assert mssd(at(0.0)[0] @ about_axis((0, 0, 1), 0.7), at(0.0), rod)[0] < 0.01 * 0.01  # half a step at the rim
    assert mssd(at(0.0)[0] @ about_axis((1, 0, 0), np.pi), at(0.0), rod)[0] > 0.05


def test_perfect_and_empty():
    perfect = frame(at(0.2, 0.0), [0.3, 0.9], at(0.0, 0.2))
    assert ap_sileane([perfect], PLAIN) == ap_mssd([perfect], PLAIN) == 1
    assert ap_sileane([NOTHING], PLAIN) == ap_mssd([NOTHING], PLAIN) == 0


def test_a_false_one_between_two_right_ones():
    found = frame(at(0.0, 0.1, 0.2), [0.9, 0.8, 0.7], at(0.0, 0.2))
    # precision 1 at recall 1/2, then 2/3 at recall 1
    assert ap_sileane([found], PLAIN) == pytest.approx(0.5 * 1 + 0.5 * 2 / 3)
    assert ap_mssd([found], PLAIN) == pytest.approx((51 * 1 + 50 * 2 / 3) / 101)


def test_order_of_scores_and_not_of_the_list_counts():
    found = frame(at(0.0, 0.1, 0.2), [0.8, 0.9, 0.7], at(0.0, 0.2))
    # precision 0, 1/2, 2/3: Bregier's area takes each as it is, BOP's the best at greater recall
    assert ap_sileane([found], PLAIN) == pytest.approx(0.5 * 1 / 2 + 0.5 * 2 / 3)
    assert ap_mssd([found], PLAIN) == pytest.approx(2 / 3)


def test_a_duplicate_is_false():
    twice = frame(at(0.0, 0.001, 0.2), [0.9, 0.8, 0.7], at(0.0, 0.2))
    assert ap_sileane([twice], PLAIN) == pytest.approx(0.5 + 0.5 * 2 / 3)
    assert ap_mssd([twice], PLAIN) == pytest.approx((51 * 1 + 50 * 2 / 3) / 101)


def test_the_nearest_of_two_is_the_right_one_for_bregier_and_the_first_for_bop():
    # alone, the 5 mm one is right; beside the exact one it is a duplicate, and none is lost
    twice = frame(at(0.005, 0.0), [0.9, 0.8], at(0.0))
    assert ap_sileane([twice], PLAIN) == 1
    # at 2 and 4 mm the first one is false and the second right, with precision 1/2
    assert ap_mssd([twice], PLAIN) == pytest.approx((2 * 0.5 + 8 * 1) / 10)


def test_thresholds_in_mm():
    assert ap_mssd([frame(at(0.005), [1.0], at(0.0))], PLAIN) == pytest.approx(0.8)  # 6, 8, .. 20 mm of ten
    assert ap_sileane([frame(at(0.0069), [1.0], at(0.0))], PLAIN) == 1
    assert ap_sileane([frame(at(0.0071), [1.0], at(0.0))], PLAIN) == 0


def test_hidden_instances_neither_count_nor_punish():
    found = frame(at(0.2, 0.0), [0.9, 0.8], at(0.0, 0.2), np.array([1.0, 0.05]))
    assert ap_sileane([found], PLAIN) == ap_mssd([found], PLAIN) == 1
    # a second prediction of the hidden one is false: precision 1/2 where recall becomes 1
    twice = frame(at(0.2, 0.201, 0.0), [0.9, 0.85, 0.8], at(0.0, 0.2), np.array([1.0, 0.05]))
    assert ap_sileane([twice], PLAIN) == ap_mssd([twice], PLAIN) == pytest.approx(0.5)


def test_how_much_must_be_seen():
    half = frame(at(0.0), [0.9], at(0.0, 0.2), np.array([1.0, 0.3]))
    assert ap_sileane([half], PLAIN) == 1  # the other is hidden to more than half
    assert ap_mssd([half], PLAIN) == pytest.approx(51 / 101)  # and for BOP it is not


def test_symmetric_poses_are_right():
    block, rod = workpiece(BLOCK, 0, 0, 180), workpiece(ROD, 0, 0, 5)
    for part, angle in ((block, np.pi), (rod, 1.234)):
        found = frame(at(0.0) @ about_axis((0, 0, 1), angle), [0.9], at(0.0))
        assert ap_sileane([found], part) == ap_mssd([found], part) == 1
    half_turn = frame(at(0.0) @ about_axis((0, 0, 1), np.pi), [0.9], at(0.0))
    assert ap_sileane([half_turn], PLAIN) == ap_mssd([half_turn], PLAIN) == 0


def test_frames_are_averaged_by_bregier_and_pooled_by_bop():
    # frame 1: one of one; frame 2: one of three
    frames = [frame(at(0.0), [0.9], at(0.0)), frame(at(0.0), [0.9], at(0.0, 0.1, 0.2))]
    assert ap_sileane(frames, PLAIN) == pytest.approx((1 + 1 / 3) / 2)
    assert ap_mssd(frames, PLAIN) == pytest.approx(51 / 101)


def test_nothing_to_average():
    hidden = frame(at(0.0), [0.9], at(0.0), np.zeros(1))
    with pytest.raises(ValueError, match="no instance"):
        ap_mssd([hidden], PLAIN)
    with pytest.raises(ValueError, match="no frames"):
        ap_sileane([], PLAIN)


def test_visible_share_against_a_render_alone():
    # one block covers the left half of another, 20 mm below it; a third lies apart
    Ts = make_transform(t=[(0, 0, 0.80), (-0.03, 0, 0.78), (0.08, 0.06, 0.80)])
    exact = render(PLAIN.vertices, PLAIN.faces, Ts, (), artificial.INTRINSICS, np.eye(4))
    alone = unoccluded_pixels(PLAIN, Ts, artificial.INTRINSICS)
    f = artificial.INTRINSICS.fx / 0.79  # pixels a metre on the face towards the camera
    assert alone[0] == pytest.approx(0.06 * 0.03 * f**2, rel=0.02)
    share = visible_share(exact, PLAIN, Ts, artificial.INTRINSICS)
    assert share[1:] == pytest.approx([1.0, 1.0], abs=0.01)
    assert share[0] == pytest.approx(0.5, abs=0.03)
