"""Lengths in millimetres and angles in degrees where a configuration is in m and rad."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from pickproof.cell.config import Config, parse, parse_yaml, read_yaml
from pickproof.cell.errors import InputError
from pickproof.cell.grippers.registry import SHIPPED as GRIPPERS
from pickproof.cell.grippers.registry import list_grippers, load_gripper
from pickproof.cell.sensing.sensor_model import SensorConfig
from pickproof.cell.workpiece.workpiece import WorkpieceConfig, list_workpieces
from pickproof.grasping.grasp_points import GraspTable
from pickproof.robots.kinematics.model import RobotConfig, list_robots
from pickproof.scenarios.config.scenario import Scenario
from pickproof.scenarios.config.shipped import WORKPIECES

MM = 1000.0
BRACKET = WORKPIECES / "bracket"
SCENARIO = WORKPIECES.parent / "bracket.yaml"
ROBOT = WORKPIECES.parent.parent / "robots" / "lrmate200id" / "robot.yaml"


def scaled(value: Any) -> Any:
    return [scaled(entry) for entry in value] if isinstance(value, list) else MM * value


def at(data: Any, field: str) -> tuple[Any, Any]:
    """The mapping or list that holds a dotted field, and its key there."""
    *path, last = (int(key) if key.isdigit() else key for key in field.split("."))
    for key in path:
        data = data.setdefault(key, {}) if isinstance(data, dict) else data[key]
    return data, last


def refused(model: type[Config], data: Any, field: str, hint: str) -> None:
    with pytest.raises(InputError) as caught:
        parse(model, data, "file.yaml")
    assert caught.value.field.startswith(field) and hint in str(caught.value), caught.value


@pytest.mark.parametrize(
    ("model", "path", "field", "value"),
    [
        (Scenario, SCENARIO, "source_bin.inner", [0.26, 0.2, 0.06]),
        (Scenario, SCENARIO, "source_bin.position", [0.45, 0.0, 0.01]),
        (Scenario, SCENARIO, "source_bin.wall", 0.006),
        (Scenario, SCENARIO, "place_bin.position", [0.16, -0.43, 0.01]),
        (Scenario, SCENARIO, "table.size", [1.6, 1.6, 0.05]),
        (Scenario, SCENARIO, "table.centre_top", [0.2, 0.0, 0.0]),
        (Scenario, SCENARIO, "camera.eye", [0.45, 0.0, 0.86]),
        (Scenario, SCENARIO, "camera.target", [0.45, 0.0, 0.01]),
        (Scenario, SCENARIO, "carry.straight", 0.012),
        (Scenario, SCENARIO, "sensor.edge_jump", 0.004),
        (Scenario, SCENARIO, "sensor.axial_sigma", 0.00012),
        (Scenario, SCENARIO, "sensor.baseline", 0.12),
        (WorkpieceConfig, BRACKET / "workpiece.yaml", "collision_boxes.0.size", [0.02, 0.012, 0.006]),
        (WorkpieceConfig, BRACKET / "workpiece.yaml", "collision_boxes.0.centre", [-0.018, -0.003, -0.0045]),
        (WorkpieceConfig, BRACKET / "workpiece.yaml", "heap.bin_inner", [0.26, 0.2, 0.08]),
        (WorkpieceConfig, BRACKET / "workpiece.yaml", "heap.camera_distance", 0.85),
        (WorkpieceConfig, BRACKET / "workpiece.yaml", "tolerance", 0.005),
        (GraspTable, BRACKET / "grasps.yaml", "grasps.0.centre", [0.01, 0.0, 0.0]),
        (GraspTable, BRACKET / "grasps.yaml", "grasps.0.width", 0.018),
        (GraspTable, BRACKET / "grasps.yaml", "grasps.0.depths", [0.006]),
        (GraspTable, BRACKET / "grasps.yaml", "grasps.0.tolerance", 0.003),
        (GraspTable, BRACKET / "grasps.yaml", "grasps.0.retract_distance", 0.1),
        (RobotConfig, ROBOT, "reach", 0.717),
        (RobotConfig, ROBOT, "opw.c1", 0.33),
    ],
)
def test_millimetres_are_named(model: type[Config], path: Path, field: str, value: Any) -> None:
    data = read_yaml(path)
    holder, key = at(data, field)
    holder[key] = value
    parse(model, data, path)
    holder[key] = scaled(value)
    refused(model, data, field, "in mm?")


def of_gripper(name: str, field: str, change: Callable[[Any], Any], folder: Path) -> Path:
    data = read_yaml(GRIPPERS / f"{name}.yaml")
    holder, key = at(data, field)
    holder[key] = change(holder[key])
    path = folder / f"{name}.yaml"
    YAML().dump(data, path)
    return path


@pytest.mark.parametrize(
    ("name", "field"),
    [
        ("jaw_v1", "max_opening"),
        ("jaw_v1", "finger_size"),
        ("jaw_v1", "flange_to_tcp"),
        ("jaw_v1", "body.0.size"),
        ("jaw_v1", "body.1.centre"),
        ("jaw_v_rod", "groove.height"),
        ("cup_20", "diameter"),
        ("cup_20", "stroke"),
        ("cup_20", "flatness"),
        ("cup_bar", "centres.0"),
        ("magnet_20", "gap_scale"),
    ],
)
def test_millimetres_of_a_gripper_are_named(name: str, field: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"in m, is it in mm\?") as caught:
        load_gripper(str(of_gripper(name, field, scaled, tmp_path)))
    assert field.split(".")[-1] in caught.value.field or field in caught.value.field


def test_degrees_are_named() -> None:
    data = read_yaml(SCENARIO)
    data["source_bin"]["yaw"] = 1.57
    parse(Scenario, data, SCENARIO)
    data["source_bin"]["yaw"] = 90
    refused(Scenario, data, "source_bin.yaw", "in degrees?")
    data = read_yaml(BRACKET / "workpiece.yaml")
    data["collision_boxes"][0]["rpy"] = [0, 0, -45]
    refused(WorkpieceConfig, data, "collision_boxes.0.rpy.2", "in degrees?")


def test_what_is_shipped_is_in_metres() -> None:
    for name in list_workpieces():
        parse(WorkpieceConfig, read_yaml(WORKPIECES / name / "workpiece.yaml"), name)
        parse(GraspTable, read_yaml(WORKPIECES / name / "grasps.yaml"), name)
    for name in list_grippers():
        load_gripper(name)
    for name in list_robots():
        parse(RobotConfig, read_yaml(WORKPIECES.parent.parent / "robots" / name / "robot.yaml"), name)
    for path in WORKPIECES.parent.glob("*.yaml"):
        parse(Scenario, read_yaml(path), path)
    SensorConfig.of_preset("stereo")


@pytest.mark.slow
@pytest.mark.parametrize(
    "text", ["a: 2023-02-30", "a: " + "[" * 4000, "{[1]: 2}", "a: &x [*x]\nb: {<<: *x}", "a: \x00", "? {a: 1}\n: 2"]
)
def test_text_that_is_no_mapping_of_fields_is_one_error(text: str) -> None:
    with pytest.raises(InputError):
        parse(Scenario, parse_yaml(text, Path("file.yaml")), "file.yaml")


def test_an_unknown_field_in_a_pattern_is_named() -> None:
    data = read_yaml(SCENARIO)
    data["place"] = {"kind": "pattern", "rows": 1, "columns": 1, "pitch": [0.1, 0.1], "part_position": [0, 0, 0]}
    parse(Scenario, data, SCENARIO)
    refused(Scenario, data | {"place": data["place"] | {"spacing": 0.1}}, "place", "no such field")
