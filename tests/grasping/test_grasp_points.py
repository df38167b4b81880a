from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array, about_axis, apply, invert
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.grippers.parallel_jaw import ParallelJaw
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.symmetry.symmetry import Symmetry
from pickproof.cell.workpiece.workpiece import Workpiece, list_workpieces, load_workpiece
from pickproof.grasping.grasp_points import (
    OPENING_MARGIN,
    GraspPoint,
    GraspPoses,
    Slide,
    Turn,
    expand,
    load_grasps,
    opening,
    read_table,
)

PLAIN: dict[str, Any] = {
    "name": "g",
    "centre": (0.01, -0.002, 0.003),
    "approach": (0, 3, 4),
    "closing": (2, 0, 0),
    "width": 0.01,
    "flip": False,
}


def point(**changes: Any) -> GraspPoint:
    return GraspPoint.model_validate(PLAIN | changes)


def test_tool_z_is_the_approach_and_tool_x_the_closing_direction(bracket: Workpiece) -> None:
    (T,) = expand((point(depths=(0.007,)),), bracket).Ts_part_tool
    np.testing.assert_allclose(T[:3, 2], [0, 0.6, 0.8], atol=1e-12)
    np.testing.assert_allclose(T[:3, 0], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(T[:3, 3], np.array(PLAIN["centre"]) + 0.007 * T[:3, 2], atol=1e-12)
    np.testing.assert_allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), atol=1e-12)
    assert np.linalg.det(T[:3, :3]) > 0


def test_every_freedom_multiplies(bracket: Workpiece) -> None:
    wide = point(
        depths=(0.004, 0.002),
        flip=True,
        slide=Slide(along=(1, 0, 0), offsets=(0.0, 0.01, -0.01)),
        tool_rotation=Turn(from_deg=-30, to_deg=30, step_deg=15),
        part_rotation=Turn(from_deg=0, to_deg=90, step_deg=45),
    )
    out = expand((wide, point(enabled=False), point(name="h", depths=(0.001,))), bracket)
    assert np.bincount(out.index).tolist() == [2 * 2 * 3 * 5 * 3, 0, 1]
    n = len(out.index)
    assert out.Ts_part_tool.shape == (n, 4, 4)
    assert len(out.openings) == len(out.depth_rank) == len(out.offset) == n
    assert set(out.depth_rank.tolist()) == {0, 1}
    assert set(out.offset.tolist()) == {0.0, 0.01}
    assert len(np.unique(out.Ts_part_tool.reshape(n, -1).round(9), axis=0)) == n


def test_nothing_enabled_gives_no_pose(bracket: Workpiece) -> None:
    out = expand((point(enabled=False),), bracket)
    assert out.Ts_part_tool.shape == (0, 4, 4)
    assert len(out.index) == len(out.openings) == 0


def test_a_flip_turns_the_jaws_and_keeps_closing_line_and_tip(bracket: Workpiece) -> None:
    a, b = expand((point(flip=True),), bracket).Ts_part_tool
    np.testing.assert_allclose(b[:3, 0], -a[:3, 0], atol=1e-12)
    np.testing.assert_allclose(b[:3, 2:], a[:3, 2:], atol=1e-12)


def test_tool_rotation_turns_about_the_closing_direction_through_the_grip_centre(bracket: Workpiece) -> None:
    turned = point(depths=(0.006,), tool_rotation=Turn(from_deg=-60, to_deg=60, step_deg=20))
    Ts = expand((turned,), bracket).Ts_part_tool
    np.testing.assert_allclose(Ts[:, :3, 0], np.tile([1.0, 0, 0], (len(Ts), 1)), atol=1e-12)
    grip = Ts[:, :3, 3] - 0.006 * Ts[:, :3, 2]  # depth runs along each pose's own approach
    np.testing.assert_allclose(grip, np.tile(PLAIN["centre"], (len(Ts), 1)), atol=1e-12)
    angles = np.rad2deg(np.arccos(np.clip(Ts[:, :3, 2] @ [0, 0.6, 0.8], -1, 1)))
    np.testing.assert_allclose(angles, [0, 20, 20, 40, 40, 60, 60], atol=1e-9)  # least turn first


def test_part_rotation_turns_about_its_axis_through_the_origin(bracket: Workpiece) -> None:
    plain = expand((point(),), bracket).Ts_part_tool[0]
    turned = point(part_axis=(0, 0, 2), part_rotation=Turn(from_deg=-90, to_deg=180, step_deg=90))
    Ts = expand((turned,), bracket).Ts_part_tool
    for T, quarter in zip(Ts, (0, -1, 1, 2), strict=True):
        np.testing.assert_allclose(T, about_axis((0, 0, 1), np.array(quarter * np.pi / 2)) @ plain, atol=1e-12)


def test_slides_move_the_centre_and_nothing_else(bracket: Workpiece) -> None:
    slid = point(slide=Slide(along=(0, 0, 5), offsets=(0.0, 0.004)))
    a, b = expand((slid,), bracket).Ts_part_tool
    np.testing.assert_allclose(b - a, np.outer([0, 0, 0.004, 0], [0, 0, 0, 1]), atol=1e-12)


@pytest.mark.parametrize(("degrees", "n"), [((0, 0, 180), 2), ((0, 0, 90), 4), ((180, 180, 180), 4), ((0, 0, 1), 24)])
def test_symmetry_makes_every_grasp_again_on_each_equal_side(
    bracket: Workpiece, degrees: tuple[float, float, float], n: int
) -> None:
    symmetric = replace(bracket, symmetry=Symmetry(degrees))
    alone, all_ = expand((point(),), bracket).Ts_part_tool[0], expand((point(),), symmetric).Ts_part_tool
    assert len(all_) == n
    assert len(np.unique(all_.reshape(n, -1).round(6), axis=0)) == n
    for S in symmetric.symmetry.rotations():  # the set is one orbit: turning the part maps it onto itself
        turned = np.einsum("ij,njk->nik", np.block([[S, np.zeros((3, 1))], [np.zeros(3), 1]]), all_)
        gaps = np.abs(turned[:, None] - all_[None]).max((2, 3)).min(1)
        assert gaps.max() < 1e-9
    assert np.abs(all_ - alone).max((1, 2)).min() < 1e-12


def test_a_grasp_that_symmetry_gives_twice_is_kept_once(bracket: Workpiece) -> None:
    """Half a turn about the approach is the flip: symmetric parts would give each pose twice."""
    straight_down = point(centre=(0, 0, 0.003), approach=(0, 0, -1), closing=(1, 0, 0), flip=True)
    two_fold = replace(bracket, symmetry=Symmetry((0, 0, 180)))
    assert len(expand((straight_down,), two_fold).index) == 2
    round_part = replace(bracket, symmetry=Symmetry((0, 0, 1)))
    assert len(expand((straight_down,), round_part).index) == 24
    turned = straight_down.model_copy(update={"part_rotation": Turn(from_deg=-90, to_deg=90, step_deg=15)})
    assert len(expand((turned,), round_part).index) == 24
    assert len(expand((straight_down.model_copy(update={"symmetry": False}),), round_part).index) == 2


def test_of_equal_poses_the_most_wanted_is_kept(bracket: Workpiece) -> None:
    """Slid by the difference of two depths along the approach, a pose comes up again as a less wanted one."""
    along = point(slide=Slide(along=(0, 3, 4), offsets=(0.0, 0.002)), depths=(0.004, 0.002))
    out = expand((along,), bracket)
    assert len(out.index) == 3
    same = np.argmin(np.abs(out.Ts_part_tool[:, :3, 3] - PLAIN["centre"] - 0.004 * np.array([0, 0.6, 0.8])).sum(1))
    assert (out.depth_rank[same], out.offset[same]) == (0, 0.0)


def test_approach_rotation_turns_the_tool_about_its_own_axis(bracket: Workpiece) -> None:
    plain = expand((point(),), bracket).Ts_part_tool[0]
    spun = expand((point(approach_rotation=Turn(from_deg=-60, to_deg=60, step_deg=30)),), bracket).Ts_part_tool
    assert len(spun) == 5
    for T, deg in zip(spun, (0, -30, 30, -60, 60), strict=True):
        np.testing.assert_allclose(T, plain @ about_axis((0, 0, 1), np.deg2rad(deg)), atol=1e-12)


def test_only_what_is_enabled_and_for_the_gripper_is_expanded(bracket: Workpiece) -> None:
    mine, other = point(name="a", gripper="jaw_v1"), point(name="b", gripper="cup", flip=True)
    off = point(name="c", gripper="jaw_v1", enabled=False, depths=(0.001, 0.002, 0.003))
    out = expand((mine, other, off), bracket, "jaw_v1")
    assert set(out.index.tolist()) == {0}
    assert out.disabled == {"b": 2, "c": 3}


def test_opening_leaves_a_margin_on_each_side() -> None:
    assert opening(point(width=0.02)) == pytest.approx(0.02 + 2 * OPENING_MARGIN)
    assert opening(point(width=0.02, opening=0.05)) == 0.05
    assert opening(point(width=0.02, stroke=0.012)) == pytest.approx(0.032)


# The shipped tables against the shipped CAD: a wrong centre, width, direction or freedom shows here.

TABLES = [n for n in list_workpieces() if (load_workpiece(n).folder / "grasps.yaml").is_file()]


FREEFORM = {"bunny"}


def gripper_of(name: str) -> Gripper:
    """That of a workpiece's table."""
    return load_gripper(read_table(load_workpiece(name).folder / "grasps.yaml").gripper)


def unlike_poses(workpiece: Workpiece, gripper: Gripper) -> Iterator[tuple[GraspPoint, Array]]:
    """Grasp points with their poses; symmetric and flipped ones meet the same material and are left out."""
    points = tuple(p.model_copy(update={"flip": False}) for p in load_grasps(workpiece, gripper).points)
    out = expand(points, replace(workpiece, symmetry=Symmetry()))
    for i, T in zip(out.index, out.Ts_part_tool, strict=True):
        yield points[i], T


@pytest.mark.parametrize("name", TABLES)
def test_shipped_pads_meet_material_on_both_sides(name: str) -> None:
    """Each pad's inner face, `width` apart, lies within 0.3 mm on CAD surface that faces it: at least 25 mm2 of it.

    On a round the pad touches along a line, and the strip within 0.3 mm of it is what counts. Freeform workpieces touch
    in points, grooves hold by their flanks, cups by their rim: those are left to the physics.
    """
    workpiece, gripper = load_workpiece(name), gripper_of(name)
    if not isinstance(gripper, ParallelJaw) or gripper.groove is not None or name in FREEFORM:
        pytest.skip("held in points, by the flanks of a groove, or by a rim")
    surface, normals = workpiece.sample_surface(int(workpiece.mesh.area / 0.5e-6), seed=3)
    per_point = workpiece.mesh.area / len(surface)
    _, finger_width, finger_length = gripper.finger_size
    for grasp, T in unlike_poses(workpiece, gripper):
        p, n = apply(invert(T), surface), normals @ T[:3, :3]
        on_pad = (np.abs(p[:, 1]) < finger_width / 2) & (p[:, 2] < 0) & (p[:, 2] > -finger_length)
        for side in (-1, 1):
            touching = on_pad & (np.abs(p[:, 0] - side * grasp.width / 2) < 3e-4) & (n[:, 0] * side > 0.95)
            area = touching.sum() * per_point
            assert area > 25e-6, f"{grasp.name}: {1e6 * area:.1f} mm2 under pad {side} at\n{T}"


@pytest.mark.slow
@pytest.mark.parametrize("name", TABLES)
def test_shipped_grasps_leave_the_workpiece_room(name: str) -> None:
    """No finger and no gripper body goes more than 0.1 mm into the CAD, open on the way in and closed on it.

    A groove counts as filled, so grooved fingers are only looked at open; a cup gives way by its stroke.
    """
    workpiece, gripper = load_workpiece(name), gripper_of(name)
    sample = workpiece.sample_surface(int(workpiece.mesh.area / 1e-6), seed=4)[0]
    surface = np.concatenate([sample, workpiece.vertices])
    for grasp, T in unlike_poses(workpiece, gripper):
        boxes = gripper.boxes(opening(grasp)) if isinstance(gripper, ParallelJaw) else gripper.body_boxes()
        if isinstance(gripper, ParallelJaw) and gripper.groove is None:
            boxes += gripper.finger_boxes(grasp.width)
        p = apply(invert(T), surface)
        for box in boxes:
            inside = (np.asarray(box.size) / 2 - np.abs(p - box.T_world_box[:3, 3])).min(axis=1).max()
            assert inside < 1e-4, f"{grasp.name}: {box.name} is {1000 * inside:.2f} mm in the workpiece at\n{T}"


def test_shipped_grasps_can_take_a_part_that_lies_any_way(poses: GraspPoses) -> None:
    """Over random rotations, nearly all have a grasp from above."""
    rng = np.random.default_rng(0)
    down = rng.standard_normal((500, 3))
    down /= np.linalg.norm(down, axis=1, keepdims=True)
    upright = (down @ poses.Ts_part_tool[:, :3, 2].T).max(axis=1) > np.cos(np.deg2rad(45))
    assert upright.mean() > 0.85


# Errors


def write(folder: Path, grasps: list[dict[str, Any]], gripper: str = "jaw_v1") -> Path:
    path = folder / "grasps.yaml"
    plain = [{k: list(v) if isinstance(v, tuple) else v for k, v in g.items()} for g in grasps]
    path.write_text(yaml.safe_dump({"gripper": gripper, "grasps": plain}))
    return path


@pytest.mark.parametrize(
    ("change", "names"),
    [
        ({"width": -0.01}, ["grasps.0.width", "-0.01", "greater than 0"]),
        ({"width": "wide"}, ["grasps.0.width", "'wide'", "number"]),
        ({"centre": [0.0, 0.0]}, ["grasps.0.centre"]),
        ({"depths": []}, ["grasps.0.depths", "at least 1"]),
        ({"widht": 0.01}, ["grasps.0.widht", "no such field"]),
        ({"closing": [0, 1, 0]}, ["grasps.0", "right angles"]),
        ({"approach": [0, 0, 0]}, ["grasps.0", "zero"]),
        ({"part_axis": [0, 0, 0]}, ["grasps.0", "part_axis"]),
        ({"world_approach": [0, 0, 0]}, ["grasps.0", "world_approach must not be zero"]),
        ({"max_tilt_deg": 200}, ["grasps.0.max_tilt_deg", "200"]),
        ({"robustness": -0.1}, ["grasps.0.robustness", "-0.1"]),
        ({"approach_rotation": {"from_deg": -190}}, ["grasps.0.approach_rotation.from_deg", "-190"]),
        ({"stroke": 0}, ["grasps.0.stroke", "0"]),
        ({"stroke": 0.01, "opening": 0.02}, ["grasps.0", "opening and stroke exclude each other"]),
        ({"opening": 0.009}, ["grasps.0", "opening must not be below width"]),
        ({"stroke": 0.055}, ["grasps.0.opening", "0.065", "0.06 m"]),
        ({"enabled": "perhaps"}, ["grasps.0.enabled", "perhaps"]),
        ({"gripper": "vacuum_v1"}, ["grasps", "vacuum_v1", "jaw_v1"]),
        ({"name": ""}, ["grasps.0.name", "at least 1"]),
        ({"priority": 1.5}, ["grasps.0.priority", "1.5"]),
        ({"opening": 0.061}, ["grasps.0.opening", "0.061", "0.06 m"]),
        ({"width": 0.058}, ["grasps.0.opening", "0.063", "0.06 m"]),
        ({"tool_rotation": {"from_deg": 30, "to_deg": -30}}, ["grasps.0.tool_rotation", "to_deg"]),
        ({"tool_rotation": {"step_deg": 0}}, ["grasps.0.tool_rotation.step_deg", "0"]),
        ({"slide": {"along": [1, 0, 0], "offsets": []}}, ["grasps.0.slide.offsets"]),
        ({"slide": {"along": [0, 0, 0], "offsets": [0.0]}}, ["grasps.0.slide", "zero"]),
        ({"depths": [float("nan")]}, ["grasps.0.depths.0", "nan"]),
    ],
)
def test_bad_entries_name_file_field_and_value(
    tmp_path: Path, bracket: Workpiece, gripper: Gripper, change: dict[str, Any], names: list[str]
) -> None:
    path = write(tmp_path, [PLAIN | change])
    with pytest.raises(InputError) as caught:
        load_grasps(replace(bracket, folder=tmp_path), gripper)
    for name in [str(path), *names]:
        assert name in str(caught.value)


def test_bad_files(tmp_path: Path, bracket: Workpiece, gripper: Gripper) -> None:
    mine = replace(bracket, folder=tmp_path)
    with pytest.raises(InputError, match=r"grasps\.yaml.*missing file"):
        load_grasps(mine, gripper)
    write(tmp_path, [PLAIN], gripper="suction_v9")
    with pytest.raises(InputError, match=r"gripper: 'suction_v9'.*jaw_v1"):
        load_grasps(mine, gripper)
    write(tmp_path, [PLAIN, PLAIN])
    with pytest.raises(InputError, match=r"grasps\.1\.name: 'g'.*a name that no other grasp point has"):
        load_grasps(mine, gripper)
    write(tmp_path, [])
    with pytest.raises(InputError, match=r"grasps.*at least 1"):
        load_grasps(mine, gripper)


def test_the_shortest_entry_takes_the_defaults(tmp_path: Path, bracket: Workpiece, gripper: Gripper) -> None:
    write(tmp_path, [{k: PLAIN[k] for k in ("name", "centre", "approach", "closing", "width")}])
    out = load_grasps(replace(bracket, folder=tmp_path), gripper)
    assert len(out.index) == 2  # flipped and not
    np.testing.assert_allclose(out.openings, 0.015)
