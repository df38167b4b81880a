"""What geometry says of a grasp, against boxes and cylinders whose answers are known, and snapping and mirroring."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from pickproof.cell.errors import InputError
from pickproof.cell.frames import about_axis, apply, make_transform, random_rotations
from pickproof.cell.grippers.parallel_jaw import ParallelJaw
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from pickproof.grasping.grasp_points import GraspPoint, Slide, Turn, expand, load_grasps
from pickproof.scenarios.grasp_editor.geometry_checks import GraspJudge
from pickproof.scenarios.grasp_editor.snapping import (
    Plane,
    Snapping,
    SnapTargets,
    fields_of,
    frame_of,
    grip_frame,
    mirrored,
    squared,
)

pytestmark = pytest.mark.slow

BRACKET, JAW = load_workpiece("bracket"), load_gripper("jaw_v1")
assert isinstance(JAW, ParallelJaw)
ONLY = Snapping(False, False, False, False)


def solid(mesh: trimesh.Trimesh) -> Workpiece:
    """The bracket's file with another shape: only mesh, mass and centre of mass are looked at."""
    return replace(
        BRACKET,
        vertices=np.array(mesh.vertices),
        faces=np.array(mesh.faces),
        com=np.array(mesh.center_mass),
        mass=1.0,
    )


def block() -> Workpiece:
    return solid(trimesh.creation.box((0.06, 0.02, 0.03)))


def across(**changes: object) -> GraspPoint:
    """Across the 20 mm of the block, from above, tips 10 mm below its top."""
    fields: dict[str, object] = {
        "name": "across", "centre": (0, 0, 0.01), "approach": (0, 0, -1), "closing": (0, 1, 0), "width": 0.02,
        "depths": (0.005,),
    }  # fmt: skip
    return GraspPoint.model_validate(fields | changes)


def test_a_block_between_the_pads() -> None:
    """Pads of 10 mm width, 10 mm deep: 100 mm2 on each side; the centre of mass is 10 mm above the tips' line."""
    judge = GraspJudge(block(), JAW)
    verdict = judge.judge(across())
    assert verdict.hits == () and judge.doubts(verdict, across()) == []
    assert verdict.width == pytest.approx(0.02, abs=1e-9)
    assert verdict.areas == pytest.approx((100e-6, 100e-6), rel=0.25)  # sampled
    assert verdict.angles == pytest.approx((0.0, 0.0), abs=1e-6)
    assert verdict.com_offset == pytest.approx(0.005, abs=1e-9)
    assert verdict.off_centre == pytest.approx(0.0, abs=1e-9)


def test_every_fault_is_named() -> None:
    judge = GraspJudge(block(), JAW)
    cases = {
        "closing pushes the part by 3.0 mm": across(centre=(0, 0.003, 0.01), opening=0.03),
        "would penetrate the part": across(centre=(0, 0.005, 0.01)),
        "a pad does not meet the part": across(centre=(0.1, 0, 0.01)),
        "wide here, not 15.0 mm": across(width=0.015, opening=0.03),
        "of face under a pad": across(centre=(0.0345, 0, 0.01)),
    }
    for said, point in cases.items():
        assert any(said in doubt for doubt in judge.doubts(judge.judge(point), point)), said
    turned = about_axis((0, 0, 1), np.deg2rad(40.0))[:3, :3]
    slanted = across(closing=tuple(turned @ (0, 1, 0)), opening=0.055)
    assert max(judge.judge(slanted).angles) > judge.cone
    assert np.rad2deg(judge.cone) == pytest.approx(np.rad2deg(np.arctan(np.sqrt(0.8 * 0.5))))


def test_the_gripper_is_looked_for_on_its_whole_way_in() -> None:
    """A roof over the block: there is room at the grasp, but not on the way to it."""
    roof = trimesh.creation.box((0.06, 0.06, 0.004), make_transform(t=(0, 0, 0.15)))
    part = solid(trimesh.util.concatenate([trimesh.creation.box((0.06, 0.02, 0.03)), roof]))
    free = load_gripper("jaw_v1")
    judge = GraspJudge(part, free)
    near, far = across(approach_distance=0.001), across(approach_distance=0.2)
    assert judge.judge(far).hits and set(judge.judge(near).hits) <= set(judge.judge(far).hits)


def test_a_cylinder_is_as_wide_as_it_is_wherever_it_is_taken() -> None:
    part = solid(trimesh.creation.cylinder(0.01, 0.06, sections=128))
    judge = GraspJudge(part, JAW)
    for angle in (0.0, 0.7, 2.0):
        closing = (np.cos(angle), np.sin(angle), 0.0)
        point = across(centre=(0, 0, 0.02), closing=closing)
        verdict = judge.judge(point)
        assert verdict.width == pytest.approx(0.02, abs=1e-4)
        assert max(verdict.angles) < np.deg2rad(20)


def test_a_groove_takes_a_shaft_at_its_flanks() -> None:
    """A shaft of radius r touches flanks of half angle a where the pads are 2 (r / sin a - depth) apart."""
    jaw = load_gripper("jaw_v_shaft")
    assert isinstance(jaw, ParallelJaw) and jaw.groove is not None
    r, a = 0.015, np.deg2rad(jaw.groove.half_angle_deg)
    judge = GraspJudge(solid(trimesh.creation.cylinder(r, 0.2, sections=256)), jaw)
    point = across(centre=(0, 0, 0), approach=(0, -1, 0), closing=(1, 0, 0), width=2 * r, opening=0.05,
                   depths=(jaw.groove.above_tip,))  # fmt: skip
    verdict = judge.judge(point)
    assert verdict.width == pytest.approx(2 * (r / np.sin(a) - jaw.groove.depth), abs=3e-4)
    assert min(verdict.areas) > 50e-6 and not judge.doubts(verdict, point)


def test_verdict_is_the_same_wherever_the_part_is_turned() -> None:
    """The law: turning workpiece and grasp together changes nothing but the sampling."""
    R = random_rotations(1, np.random.default_rng(4))[0]
    mesh = trimesh.creation.box((0.06, 0.02, 0.03))
    turned = mesh.copy().apply_transform(make_transform(R))
    a = GraspJudge(solid(mesh), JAW).judge(across(centre=(0.004, 0.001, 0.01), opening=0.03))
    point = across(centre=tuple(R @ (0.004, 0.001, 0.01)), approach=tuple(R @ (0, 0, -1)), closing=tuple(R @ (0, 1, 0)),
                   opening=0.03)  # fmt: skip
    b = GraspJudge(solid(turned), JAW).judge(point)
    assert b.width == pytest.approx(a.width, abs=1e-9) and b.off_centre == pytest.approx(a.off_centre, abs=1e-9)
    assert b.com_offset == pytest.approx(a.com_offset, abs=1e-9)
    assert b.areas == pytest.approx(a.areas, rel=0.3)


def test_fit_puts_the_pads_where_the_faces_are() -> None:
    judge = GraspJudge(block(), JAW)
    point = across(centre=(0, 0.003, 0.01), width=0.012, opening=0.03)
    fitted = point.model_copy(update=judge.fitted(point))
    assert fitted.centre == pytest.approx((0, 0, 0.01), abs=1e-6) and fitted.width == pytest.approx(0.02, abs=1e-5)
    assert judge.doubts(judge.judge(fitted), fitted) == []


@pytest.mark.parametrize("name", ["bracket", "tless_20", "ps6d_7", "ps6d_24"])
def test_shipped_grasps_of_flat_jaws_raise_no_doubt(name: str) -> None:
    workpiece = load_workpiece(name)
    jaw = load_gripper({"bracket": "jaw_v1", "ps6d_24": "jaw_wide"}.get(name, "jaw_deep"))
    judge = GraspJudge(workpiece, jaw)
    for point in load_grasps(workpiece, jaw).points:
        free, poses = judge.free_poses(point)
        assert free == poses
        assert judge.doubts(judge.judge(point), point) == [], point.name


def test_ten_verdicts_a_second_with_50_000_triangles() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=6, radius=0.02)
    assert len(mesh.faces) > 50_000
    judge = GraspJudge(solid(mesh), JAW)
    point = across(centre=(0, 0, 0), width=0.04)
    judge.judge(point)
    times = []
    for _ in range(10):
        begun = time.process_time()
        judge.judge(point)
        times.append(time.process_time() - begun)
    assert min(times) < 0.1


def test_cups_are_judged_by_what_they_hold() -> None:
    rail, cups = load_workpiece("ps6d_23"), load_gripper("cup_rail")
    judge = GraspJudge(rail, cups)
    top = load_grasps(rail, cups).points[0]
    good = judge.judge(top)
    assert good.use is not None and good.use < 1 and judge.doubts(good, top) == []
    beside = top.model_copy(update={"centre": (0.0, 0.04, top.centre[2])})
    assert judge.doubts(judge.judge(beside), beside) == ["the faces do not hold here"]


def test_snapping_is_to_what_is_near_and_to_nothing_else() -> None:
    targets = SnapTargets.of(block())
    T = grip_frame(np.array([0.0012, -0.0008, 0.007]), np.array([0.05, 0.02, -1.0]), np.array([0.03, 1.0, 0.1]))
    np.testing.assert_allclose(targets.snap(T, ONLY), T, atol=1e-12)
    snapped = targets.snap(T, replace(ONLY, normals=True))
    np.testing.assert_allclose(snapped[:3, 0], (0, 1, 0), atol=1e-9)
    np.testing.assert_allclose(snapped[:3, 3], T[:3, 3])
    planes = targets.snap(T, replace(ONLY, centre_planes=True))
    np.testing.assert_allclose(planes[:3, 3], (0, 0, 0.007), atol=1e-9)
    square = grip_frame(np.zeros(3), np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0]))
    np.testing.assert_allclose(planes[:3, :3], square[:3, :3], atol=1e-9)
    at_edge = grip_frame(np.array([0.0295, 0.0093, 0.0]), np.array([0, 0.1, -1.0]), np.array([1.0, 0, 0]))
    np.testing.assert_allclose(targets.snap(at_edge, replace(ONLY, edges=True))[:2, 3], (0.03, 0.01), atol=1e-6)
    moved = T @ make_transform(t=(0.0, 0.0, 0.0005))  # along the approach alone
    slid = targets.snap(moved, Snapping(), T)
    np.testing.assert_allclose(slid[:3, :3], T[:3, :3], atol=1e-12)
    again = targets.snap(snapped, Snapping())
    np.testing.assert_allclose(targets.snap(again, Snapping()), again, atol=1e-9)  # it settles


def test_planes_of_symmetry_are_those_of_the_shape() -> None:
    assert [p.name for p in SnapTargets.of(block()).symmetry_planes] == ["mirror x", "mirror y", "mirror z"]
    assert SnapTargets.of(BRACKET).symmetry_planes == ()
    assert len(SnapTargets.of(load_workpiece("gear_shaft")).symmetry_planes) == 12  # through its axis


def test_a_mirrored_grasp_has_the_mirrored_poses() -> None:
    """Mirroring all poses of a grasp gives those of its mirror image, the tool's own left and right apart."""
    point = across(
        centre=(0.012, 0.003, 0.01), approach=(0.3, 0, -1), depths=(0.004, 0.001), flip=False,
        tool_rotation=Turn(from_deg=-30, to_deg=15), approach_rotation=Turn(from_deg=0, to_deg=30),
        slide=Slide(along=(1, 0.5, 0), offsets=(0.0, 0.006)),
    )  # fmt: skip
    turning = point.model_copy(update={"part_rotation": Turn(from_deg=-15, to_deg=45), "part_axis": (0.1, 0.2, 1.0)})
    for one, offset in ((point, 0.002), (turning, 0.0)):
        plane = Plane("x", (1.0, 0.0, 0.0), offset)
        poses = [expand((p,), BRACKET).Ts_part_tool for p in (one, mirrored(one, plane, "other"))]
        M = make_transform(np.diag([-1.0, 1.0, 1.0]), (2 * offset, 0.0, 0.0))
        images = M @ poses[0] @ make_transform(np.diag([1.0, -1.0, 1.0]))
        assert len(images) == len(poses[1])
        for T in images:
            assert np.abs(poses[1] - T).max(axis=(1, 2)).min() < 1e-6
    with pytest.raises(InputError, match="through the CAD origin"):
        mirrored(turning, Plane("x", (1.0, 0.0, 0.0), 0.002), "other")
    back = mirrored(mirrored(point, plane, "other"), plane, point.name)
    np.testing.assert_allclose(frame_of(back), frame_of(point), atol=1e-8)
    assert back.tool_rotation == point.tool_rotation


def test_fields_and_frame_are_inverse() -> None:
    T = grip_frame(np.array([0.01, 0.02, -0.03]), np.array([0.2, -0.3, -1.0]), np.array([1.0, 0.2, 0.0]))
    back = frame_of(across(**fields_of(T)))
    np.testing.assert_allclose(back, T, atol=2e-6)
    assert apply(T, np.zeros((1, 3)))[0] == pytest.approx((0.01, 0.02, -0.03))


def test_the_direction_that_is_not_typed_follows() -> None:
    point = across()
    for field, value in (("approach", [1.0, 0.0, -1.0]), ("closing", [0.0, 1.0, 1.0]), ("approach", [0.0, 1.0, 0.0])):
        new = point.model_copy(update={field: tuple(value), **squared(point, {field: value})})
        assert abs(np.dot(new.approach, new.closing)) < 1e-5
    assert squared(point, {"width": 0.01}) == {}
