"""Every shipped scenario is whole: what it names exists and fits together, before any physics."""

from __future__ import annotations

import pytest

from pickproof.cell.frames import apply, invert
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.grasping.grasp_points import load_grasps
from pickproof.perception.data.scenes import heap_bin
from pickproof.robots.kinematics.model import load_robot
from pickproof.scenarios.config.scenario import Scenario, list_scenarios, load_scenario
from pickproof.scenarios.placing.slot_grid import slots_in

every_scenario = pytest.mark.parametrize("scenario", [load_scenario(n) for n in list_scenarios()], ids=list_scenarios())


@every_scenario
def test_its_grasps_are_for_its_gripper(scenario: Scenario) -> None:
    workpiece = load_workpiece(scenario.workpiece)
    grasps = load_grasps(workpiece, load_gripper(scenario.gripper))  # refuses a table for another gripper
    assert len(grasps.index) > 0


@every_scenario
def test_every_workpiece_has_a_slot_and_the_arm_may_carry_it(scenario: Scenario) -> None:
    workpiece, gripper = load_workpiece(scenario.workpiece), load_gripper(scenario.gripper)
    assert slots_in(scenario.place_bin.build("place"), workpiece, scenario.count).capacity >= scenario.count
    assert gripper.mass + workpiece.mass <= load_robot(scenario.robot).payload


@every_scenario
def test_networks_see_the_bin_that_they_were_trained_with(scenario: Scenario) -> None:
    """Floor plan as in the training heaps, at a height over the camera within the training range, all of it in view."""
    workpiece, bin = load_workpiece(scenario.workpiece), scenario.source_bin.build("source")
    assert bin.inner[:2] == pytest.approx(heap_bin(workpiece).inner[:2])
    low, high = workpiece.heap.count
    assert low <= scenario.count <= high
    camera = scenario.camera
    distance = camera.eye[2] - bin.position[2]
    assert 0.8 <= distance / workpiece.heap.camera_distance <= 1.2
    corners = [[sx * bin.inner[0] / 2, sy * bin.inner[1] / 2, 0.0] for sx in (-1, 1) for sy in (-1, 1)]
    seen = apply(invert(camera.T_world_camera) @ bin.T_world_bin, corners)
    pixels = camera.intrinsics.project(seen)
    assert (pixels > 0).all() and (pixels < (camera.width, camera.height)).all()
