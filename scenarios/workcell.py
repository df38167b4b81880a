"""The cell of a scenario, built anew for every episode: everything a pick needs, in one place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cell.arm import Arm
from cell.bin import Bin, Box
from cell.camera import DepthFrame, render
from cell.errors import SimulationError
from cell.gripper import load_gripper
from cell.observe import Snapshot, observe
from cell.sensor import measure
from cell.settle import fill_bin
from cell.tool import Gripper
from cell.workpiece import Workpiece, load_workpiece
from cell.world import World
from grasping.grasp_points import GraspPoses, load_grasps
from robots.model import RobotModel, load_robot
from scenarios.placing import Place, check_room, place_of
from scenarios.scenario import Scenario

SOURCE, PLACE = "source", "place"
FILLS = 5
"""Fills of a seed that are tried."""


@dataclass
class Workcell:
    """A filled bin under a camera and an arm.

    Attributes:
        obstacles: static boxes of the cell: table and both bins.
        dropped: workpieces that were dropped and lie in the source bin.
        pictures: whether attempts keep pictures.
    """

    scenario: Scenario
    workpiece: Workpiece
    robot: RobotModel
    gripper: Gripper
    grasps: GraspPoses
    world: World
    arm: Arm
    source: Bin
    place: Bin
    obstacles: list[Box]
    dropped: int
    pictures: bool

    @staticmethod
    def build(scenario: Scenario, seed: int, pictures: bool = False) -> Workcell:
        """Build the cell and fill the source bin in the order that `seed` gives.

        Now and then a workpiece keeps rocking; such a fill is thrown away and the next one of the seed is taken.

        Raises:
            InputError: the scenario names something that does not exist or does not fit.
            SimulationError: no fill in FILLS comes to rest.
        """
        for fill in range(FILLS - 1):
            try:
                return Workcell._build(scenario, np.random.default_rng((seed, 0, fill)), pictures)
            except SimulationError:
                continue
        return Workcell._build(scenario, np.random.default_rng((seed, 0, FILLS - 1)), pictures)

    @staticmethod
    def _build(scenario: Scenario, rng: np.random.Generator, pictures: bool) -> Workcell:
        workpiece, robot = load_workpiece(scenario.workpiece), load_robot(scenario.robot)
        gripper = load_gripper(scenario.gripper)
        grasps = load_grasps(workpiece, gripper)
        world = World(scenario.physics.timestep, scenario.physics.solver_iterations)
        try:
            source, place = scenario.source_bin.build(SOURCE), scenario.place_bin.build(PLACE)
            obstacles = [scenario.table.build(), *source.boxes(), *place.boxes()]
            for box in obstacles:
                world.add_box(box)
            arm = Arm(world, robot.urdf, robot.joints, gripper)
            arm.reset(robot.home)
            heap = fill_bin(world, workpiece, source, scenario.count, rng)
        except BaseException:
            world.close()
            raise
        dropped = int(heap.inside.sum())
        return Workcell(
            scenario, workpiece, robot, gripper, grasps, world, arm, source, place, obstacles, dropped, pictures
        )

    def close(self) -> None:
        """Free the physics; the cell cannot be used after."""
        self.world.close()

    def new_place(self) -> Place:
        """The places of the scenario, nothing placed yet."""
        return place_of(self.scenario, self.place, self.workpiece, self.gripper)

    def observe(self) -> Snapshot:
        """Ground truth, for scoring and the oracle."""
        return observe(self.world, [self.source, self.place])

    def capture(self, rng: np.random.Generator) -> tuple[DepthFrame, np.ndarray]:
        """What the sensor measures, and the instance ids (h, w) of the exact image, which are ground truth."""
        camera, sensor = self.scenario.camera, self.scenario.sensor
        exact = render(
            self.workpiece.vertices,
            self.workpiece.faces,
            self.world.part_poses(),
            self.obstacles,
            camera.intrinsics,
            camera.T_world_camera,
            sensor.projector_offset,
            reflections=sensor.sees_reflections(self.workpiece.optics),
        )
        frame = measure(exact, camera.intrinsics, camera.T_world_camera, sensor, rng, self.workpiece.optics)
        return frame, exact.ids


def check_inputs(scenario: Scenario, oracle: frozenset[str]) -> None:
    """Read everything that a run will read.

    Raises:
        InputError: something that the scenario names is missing or not valid.
    """
    workpiece = load_workpiece(scenario.workpiece)
    load_robot(scenario.robot)
    load_grasps(workpiece, load_gripper(scenario.gripper))
    check_room(scenario, workpiece)
    if "perception" not in oracle:
        from perception.weights import load_weights, weights_path

        load_weights(weights_path(workpiece), workpiece)
