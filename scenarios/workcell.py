"""The cell of a scenario, built anew for every episode: everything a pick needs, in one place."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cell.arm import Arm
from cell.bin import Bin, Box
from cell.camera import DepthFrame, render
from cell.errors import InputError, SimulationError
from cell.floating_gripper import floating_arm, floating_home
from cell.frames import Array
from cell.gripper import load_gripper
from cell.observe import Snapshot, observe
from cell.sensor import measure
from cell.settle import fill_bin
from cell.tool import Gripper
from cell.workpiece import Workpiece, load_workpiece
from cell.world import World
from grasping.grasp_points import GraspPoses, load_grasps
from robots.dynamics import Load, overload
from robots.model import RobotModel, load_robot
from scenarios.placing import Place, check_room, place_of
from scenarios.rehearsal import Rehearsal
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
        oracle: stages that ground truth replaces; with `motion` the arm is a gantry.
        home: (6,) joints of the arm, or of the gantry, before the first pick.
        rehearsal: where the grasp oracle tries grasps, else None.
    """

    scenario: Scenario
    workpiece: Workpiece
    robot: RobotModel
    gripper: Gripper
    grasps: GraspPoses
    world: World
    arm: Arm
    home: Array
    source: Bin
    place: Bin
    obstacles: list[Box]
    dropped: int
    pictures: bool
    oracle: frozenset[str] = frozenset()
    rehearsal: Rehearsal | None = None

    @staticmethod
    def build(scenario: Scenario, seed: int, pictures: bool = False, oracle: frozenset[str] = frozenset()) -> Workcell:
        """Build the cell and fill the source bin in the order that `seed` gives.

        Now and then a workpiece keeps rocking; such a fill is thrown away and the next one of the seed is taken.

        Raises:
            InputError: the scenario names something that does not exist or does not fit.
            SimulationError: no fill in FILLS comes to rest.
        """
        for fill in range(FILLS - 1):
            try:
                return Workcell._build(scenario, np.random.default_rng((seed, 0, fill)), pictures, oracle)
            except SimulationError:
                continue
        return Workcell._build(scenario, np.random.default_rng((seed, 0, FILLS - 1)), pictures, oracle)

    @staticmethod
    def _build(scenario: Scenario, rng: np.random.Generator, pictures: bool, oracle: frozenset[str]) -> Workcell:
        workpiece, robot = load_workpiece(scenario.workpiece), load_robot(scenario.robot)
        gripper = load_gripper(scenario.gripper)
        grasps = load_grasps(workpiece, gripper, table_of(scenario))
        world = World(scenario.physics.timestep, scenario.physics.solver_iterations)
        try:
            source, place = scenario.source_bin.build(SOURCE), scenario.place_bin.build(PLACE)
            obstacles = [scenario.table.build(), *source.boxes(), *place.boxes()]
            for box in obstacles:
                world.add_box(box)
            if "motion" in oracle:
                arm, home = floating_arm(world, gripper), floating_home(place, gripper)
            else:
                arm, home = Arm(world, robot.urdf, robot.joints, gripper), robot.home
            arm.reset(home)
            heap = fill_bin(world, workpiece, source, scenario.count, rng)
        except BaseException:
            world.close()
            raise
        return Workcell(
            scenario=scenario,
            workpiece=workpiece,
            robot=robot,
            gripper=gripper,
            grasps=grasps,
            world=world,
            arm=arm,
            home=home,
            source=source,
            place=place,
            obstacles=obstacles,
            dropped=int(heap.inside.sum()),
            pictures=pictures,
            oracle=oracle,
            rehearsal=Rehearsal(scenario, workpiece, gripper, source, obstacles) if "grasp" in oracle else None,
        )

    def close(self) -> None:
        """Free the physics; the cell cannot be used after."""
        self.world.close()
        if self.rehearsal is not None:
            self.rehearsal.close()

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
    workpiece, gripper = load_workpiece(scenario.workpiece), load_gripper(scenario.gripper)
    check_payload(scenario, load_robot(scenario.robot), gripper, workpiece)
    load_grasps(workpiece, gripper, table_of(scenario))
    check_room(scenario, workpiece)
    if "perception" not in oracle:
        from perception.weights import load_weights, weights_path

        load_weights(weights_path(workpiece), workpiece)


def table_of(scenario: Scenario) -> Path | None:
    """The file of grasp points that a scenario names, if it names one."""
    return Path(scenario.grasps) if scenario.grasps else None


def check_payload(scenario: Scenario, robot: RobotModel, gripper: Gripper, workpiece: Workpiece) -> None:
    """Whether the arm may carry gripper and workpiece at all.

    Raises:
        InputError: they weigh more than the robot's payload.
    """
    load = Load(gripper.mass, gripper.centre) + Load(workpiece.mass, workpiece.com)
    if overload(robot, load):
        value = f"{workpiece.name}, {workpiece.mass:.2f} kg, with {gripper.name}, {gripper.mass:.2f} kg"
        valid = f"{robot.payload:.1f} kg in all at most, the payload of {robot.name}"
        raise InputError(f"scenario {scenario.name}", "workpiece", value, valid)
