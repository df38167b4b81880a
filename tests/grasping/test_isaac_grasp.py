"""isaac_grasp files: what is written reads back as the same poses, and what others write is understood."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial import cKDTree

from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array, from_rpy, invert
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.grasping.grasp_points import GraspPoses, expand, opening
from pickproof.grasping.isaac_grasp import isaac_grasps_text, read_isaac_grasps

HAND = from_rpy((0.0, 0.0, 0.1034), (0.0, 0.0, np.pi / 2))
"""T_gripper_tool of a hand that closes along its y axis, with the finger tips 103.4 mm in front of it."""

EXAMPLE: dict[str, Any] = {
    "format": "isaac_grasp",
    "format_version": 1.0,
    "object_frame_link": "/World/part",
    "gripper_frame_link": "/World/hand",
    "created_with": "something else",
    "grasps": {
        "first": {
            "confidence": 0.75,
            "position": [0.01, -0.02, 0.15],
            "orientation": {"w": 0.0, "xyz": [1.0, 0.0, 0.0]},
            "cspace_position": {"finger_joint1": 0.009},
            "pregrasp_cspace_position": {"finger_joint1": 0.02},
        }
    },
}


def write(folder: Path, data: Any) -> Path:
    path = folder / "grasps_isaac.yaml"
    path.write_text(data if isinstance(data, str) else yaml.safe_dump(data))
    return path


@pytest.mark.slow
@pytest.mark.parametrize("frame", [np.eye(4), HAND])
def test_a_round_trip_keeps_every_pose(tmp_path: Path, bracket: Workpiece, poses: GraspPoses, frame: Array) -> None:
    path = write(tmp_path, isaac_grasps_text(poses, bracket.name, "jaw_v1", frame))
    points = read_isaac_grasps(path, frame)
    back = expand(tuple(points), bracket)
    assert len(back.index) == len(poses.index) == len({p.name for p in points})
    there, here = (g.Ts_part_tool[:, :3].reshape(-1, 12) for g in (poses, back))
    assert cKDTree(there).query(here)[0].max() < 1e-9
    assert cKDTree(here).query(there)[0].max() < 1e-9
    wanted = {p.name: p for p in poses.points}
    for point in points:
        source = wanted[point.name.rpartition("_")[0]]
        assert point.width == pytest.approx(source.width)
        assert opening(point) == pytest.approx(opening(source))
        assert point.priority == source.priority


def test_the_published_example_is_understood(tmp_path: Path) -> None:
    """A hand that looks down at the part from above: its fingers close along the part's -y."""
    (point,) = read_isaac_grasps(write(tmp_path, EXAMPLE), HAND)
    np.testing.assert_allclose(point.approach, [0, 0, -1], atol=1e-9)
    np.testing.assert_allclose(np.abs(point.closing), [0, 1, 0], atol=1e-9)
    np.testing.assert_allclose(point.centre, [0.01, -0.02, 0.15 - 0.1034], atol=1e-9)
    assert (point.width, point.opening, point.priority) == (pytest.approx(0.018), pytest.approx(0.04), 0.75)
    ros = {k.replace("_link", ""): v for k, v in EXAMPLE.items()} | {"format_version": "1.0"}
    assert read_isaac_grasps(write(tmp_path, ros), HAND) == [point]


@pytest.mark.slow
def test_what_is_written_has_the_published_fields(bracket: Workpiece, poses: GraspPoses) -> None:
    data = yaml.safe_load(isaac_grasps_text(poses, bracket.name, "jaw_v1", HAND))
    assert list(data) == ["format", "format_version", "object_frame_link", "gripper_frame_link", "grasps"]
    assert (data["format"], data["format_version"]) == ("isaac_grasp", 1.0)
    T = poses.Ts_part_tool @ invert(HAND)
    for grasp in data["grasps"].values():
        assert set(grasp) == set(EXAMPLE["grasps"]["first"])
        assert np.linalg.norm([grasp["orientation"]["w"], *grasp["orientation"]["xyz"]]) == pytest.approx(1)
        assert np.abs(T[:, :3, 3] - grasp["position"]).max(axis=1).min() < 1e-9


def changed(**fields: Any) -> dict[str, Any]:
    return EXAMPLE | {"grasps": {"first": EXAMPLE["grasps"]["first"] | fields}}


@pytest.mark.parametrize(
    ("data", "names"),
    [
        (EXAMPLE | {"format": "grasp"}, ["format", "'grasp'", "isaac_grasp"]),
        (EXAMPLE | {"format_version": 2.0}, ["format_version", "2.0"]),
        (EXAMPLE | {"grasps": {}}, ["grasps", "at least 1"]),
        (changed(confidence=1.5), ["grasps.first.confidence", "1.5"]),
        (changed(position=[0, 1]), ["grasps.first.position"]),
        (changed(orientation={"w": 1.0, "xyz": [1, 1, 1]}), ["grasps.first.orientation", "unit quaternion"]),
        (changed(cspace_position={"j": 2.0}), ["grasps.first.cspace_position", "4.0"]),
        (changed(cspace_position={"a": 0.1, "b": 0.1, "c": 0.1}), ["cspace_position", "a, b, c", "finger joints"]),
        (changed(pregrasp_cspace_position={"j": 0.001}), ["pregrasp_cspace_position", "0.002", "0.018"]),
        ("a: [", ["line"]),
    ],
)
def test_bad_files_name_field_and_value(tmp_path: Path, data: Any, names: list[str]) -> None:
    path = write(tmp_path, data)
    with pytest.raises(InputError) as caught:
        read_isaac_grasps(path, HAND)
    for name in [str(path), *names]:
        assert name in str(caught.value)
    assert str(caught.value).count("\n") == 0
