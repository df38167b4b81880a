"""The gripper's boxes, its file, and the URDF that is made of both."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
import yaml

from pickproof.cell.errors import InputError
from pickproof.cell.frames import make_transform
from pickproof.cell.grippers.base import Gripper, in_frame
from pickproof.cell.grippers.parallel_jaw import FINGERS
from pickproof.cell.grippers.registry import SHIPPED, list_grippers, load_gripper
from pickproof.cell.physics.arm_urdf import merged_urdf

URDF = """<robot name="stick"><link name="base"/><link name="arm"/><link name="tool0"/>
<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<joint name="f" type="fixed"><parent link="arm"/><child link="tool0"/><origin xyz="0 0 0.5"/></joint></robot>"""


@pytest.mark.parametrize("opening", [0.0, 0.018, 0.06])
def test_the_pads_are_the_opening_apart_and_end_at_the_tcp(gripper: Gripper, opening: float) -> None:
    left, right = gripper.finger_boxes(opening)
    assert (left.name, right.name) == ("finger_left", "finger_right")
    pad_left = left.T_world_box[0, 3] + left.size[0] / 2
    pad_right = right.T_world_box[0, 3] - right.size[0] / 2
    assert pad_left == pytest.approx(-opening / 2) and pad_right == pytest.approx(opening / 2)
    for finger in (left, right):
        assert finger.T_world_box[2, 3] + finger.size[2] / 2 == pytest.approx(0.0)


def test_the_body_fills_the_way_from_flange_to_fingers(gripper: Gripper) -> None:
    edges = [(b.T_world_box[2, 3] - b.size[2] / 2, b.T_world_box[2, 3] + b.size[2] / 2) for b in gripper.body_boxes()]
    assert min(e[0] for e in edges) == pytest.approx(-gripper.T_flange_tool[2, 3])
    assert max(e[1] for e in edges) == pytest.approx(-gripper.finger_size[2])


def test_boxes_in_the_flange_frame_are_the_same_boxes(gripper: Gripper) -> None:
    back = in_frame(gripper.flange_boxes(0.03), np.linalg.inv(gripper.T_flange_tool))
    for a, b in zip(gripper.boxes(0.03), back, strict=True):
        assert a.name == b.name and a.size == b.size
        np.testing.assert_allclose(a.T_world_box, b.T_world_box, atol=1e-12)
    np.testing.assert_allclose(gripper.T_flange_tool, make_transform(t=(0, 0, 0.16)))


def test_an_unknown_gripper_is_told_the_known_ones() -> None:
    with pytest.raises(InputError, match="jaw_v1"):
        load_gripper("jaw")
    assert "jaw_v1" in list_grippers()


def test_a_bad_field_is_named_and_a_file_of_ones_own_is_read(tmp_path: Path) -> None:
    config = yaml.safe_load((SHIPPED / "jaw_v1.yaml").read_text())
    own = tmp_path / "own.yaml"
    own.write_text(yaml.safe_dump({**config, "name": "own", "force": 80}))
    assert load_gripper(str(own)).force == 80
    own.write_text(yaml.safe_dump({**config, "forc": 80}))
    with pytest.raises(InputError) as caught:
        load_gripper(str(own))
    assert caught.value.field == "forc" and "force" in caught.value.valid


def test_the_merged_urdf_has_the_fingers_under_the_flange(gripper: Gripper, tmp_path: Path) -> None:
    path = tmp_path / "stick.urdf"
    path.write_text(URDF)
    root = ElementTree.fromstring(merged_urdf(path, gripper, "tool0"))
    assert all(link.find("inertial") is not None for link in root.iter("link"))
    for name in FINGERS:
        joint = root.find(f"joint[@name='{name}_joint']")
        assert joint is not None and joint.get("type") == "prismatic"
        assert float(joint.find("limit").get("upper")) == gripper.max_opening / 2
    with pytest.raises(InputError, match="tool0"):
        merged_urdf(path, gripper, "flange")
    path.write_text("<robot")
    with pytest.raises(InputError, match=r"stick\.urdf"):
        merged_urdf(path, gripper, "tool0")
