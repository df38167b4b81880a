"""The cell of a scenario, built again for every episode: all that a pick needs, in one place.

Only this module decides which parts of the cell an oracle replaces.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pickproof.cell.errors import InputError, SimulationError
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.physics.arm import Arm
from pickproof.cell.physics.bin_filling import fill_bin
from pickproof.cell.physics.observation import Snapshot, observe
from pickproof.cell.physics.world import World
from pickproof.cell.sensing.camera import DepthFrame, RenderOptions, render
from pickproof.cell.sensing.sensor_model import measure
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from pickproof.grasping.grasp_points import load_grasps
from pickproof.robots.kinematics.model import RobotModel, load_robot
from pickproof.robots.motion.dynamics import Load, overload
from pickproof.scenarios.config.scenario import Scenario
from pickproof.scenarios.picking.carriers import ArmCarrier, Carrier, FloatingCarrier
from pickproof.scenarios.picking.cell_model import PLACE, SOURCE, CellModel
from pickproof.scenarios.picking.grasp_oracle import GraspOracle
from pickproof.scenarios.picking.heap_knowledge import HeapKnowledge, MeasuredHeap, TrueHeap
from pickproof.scenarios.placing.factory import check_room

FILLS = 5
"""Fills of a seed that are tried."""


@dataclass(frozen=True)
class Workcell(CellModel):
    """A filled bin under a camera and an arm: the known parts of the cell, and the physics.

    Attributes:
        carrier: of the gripper: the arm, or the floating gripper of the motion oracle.
        heap: against which grasps are checked: the measured one, or the true one of the grasp oracle.
        arm: the carrier's body in the physics, with the gripper.
        dropped: workpieces that were dropped and lie in the source bin.
        pictures: whether attempts keep pictures.
    """

    carrier: Carrier
    heap: HeapKnowledge
    world: World
    arm: Arm
    dropped: int
    pictures: bool

    @staticmethod
    def build(scenario: Scenario, seed: int, pictures: bool = False, oracle: frozenset[str] = frozenset()) -> Workcell:
        """Build the cell and fill the source bin in the order that `seed` gives.

        If a workpiece does not come to rest, the fill is discarded and the next one of the seed is used.

        Args:
            oracle: stages that ground truth replaces; `motion` and `grasp` are of the cell, `perception` is not.

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
        source, place = scenario.source_bin.build(SOURCE), scenario.place_bin.build(PLACE)
        obstacles = (scenario.table.build(), *source.boxes(), *place.boxes())
        carrier: Carrier = FloatingCarrier() if "motion" in oracle else ArmCarrier(robot)
        home = carrier.home(place, gripper)
        world = World(scenario.physics.timestep, scenario.physics.solver_iterations)
        try:
            for box in obstacles:
                world.add_box(box)
            arm = carrier.build(world, gripper)
            arm.reset(home)
            filled = fill_bin(world, workpiece, source, scenario.count, rng)
        except BaseException:
            world.close()
            raise
        heap: HeapKnowledge = MeasuredHeap()
        if "grasp" in oracle:
            trials = GraspOracle(scenario, workpiece, gripper, source, obstacles)
            heap = TrueHeap(trials, lambda: observe(world, [source, place]))
        return Workcell(
            scenario=scenario,
            workpiece=workpiece,
            robot=robot,
            gripper=gripper,
            grasps=grasps,
            home=home,
            source=source,
            place=place,
            obstacles=obstacles,
            carrier=carrier,
            heap=heap,
            world=world,
            arm=arm,
            dropped=int(filled.inside.sum()),
            pictures=pictures,
        )

    def close(self) -> None:
        """Free the physics; the cell cannot be used after."""
        self.world.close()
        self.heap.close()

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
            RenderOptions(sensor.projector_offset, sensor.sees_reflections(self.workpiece.optics)),
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
        from pickproof.perception.ps6d.weights import load_weights, weights_path

        method, path = scenario.perception.method, weights_path(workpiece)
        if method in ("ps6d", "both") or (method == "auto" and path.is_file()):
            load_weights(path, workpiece)


def table_of(scenario: Scenario) -> Path | None:
    """The file of grasp points that a scenario names, if it names one."""
    return Path(scenario.grasps) if scenario.grasps else None


def check_payload(scenario: Scenario, robot: RobotModel, gripper: Gripper, workpiece: Workpiece) -> None:
    """Check that the arm may carry gripper and workpiece.

    Raises:
        InputError: they weigh more than the robot's payload.
    """
    load = Load(gripper.mass, gripper.centre) + Load(workpiece.mass, workpiece.com)
    if overload(robot, load):
        value = f"{workpiece.name}, {workpiece.mass:.2f} kg, with {gripper.name}, {gripper.mass:.2f} kg"
        valid = f"at most {robot.payload:.1f} kg in total, the payload of {robot.name}"
        raise InputError(f"scenario {scenario.name}", "workpiece", value, valid)
