"""Everything that a replay shows of one attempt: its artefact, its record, and the cell that it happened in."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from pickproof.cell.frames import Array
from pickproof.cell.geometry.bin import Bin, Box
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.physics.floating_gripper import floating_flange
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from pickproof.robots.kinematics.links import LinkShape, link_poses, link_shapes
from pickproof.robots.kinematics.model import RobotModel, forward, load_robot
from pickproof.scenarios.config.scenario import Scenario
from pickproof.scenarios.picking.outcome import nearest_true
from pickproof.scenarios.picking.workcell import PLACE, SOURCE
from pickproof.scenarios.results.records import AttemptRecord
from pickproof.scenarios.results.replay_file import Artefact, path_of, read_artefact
from pickproof.scenarios.results.store import Store


@dataclass(frozen=True)
class Replayed:
    """One attempt with the cell of its scenario; `index` is that in the report's list of every attempt."""

    index: int
    record: AttemptRecord
    artefact: Artefact
    scenario: Scenario
    workpiece: Workpiece
    gripper: Gripper
    robot: RobotModel

    @staticmethod
    def load(directory: Path, attempt: str) -> Replayed:
        """Attempt number `attempt` of the campaign in `directory`.

        Raises:
            InputError: there is no such attempt, or it was not kept.
        """
        with Store.read(directory) as store:
            record = store.nth_attempt(attempt)
            scenario = Scenario.model_validate_json(store.meta()["scenario"])
        artefact = read_artefact(path_of(directory, record.seed, record.attempt))
        workpiece, gripper = load_workpiece(scenario.workpiece), load_gripper(scenario.gripper)
        return Replayed(int(attempt), record, artefact, scenario, workpiece, gripper, load_robot(scenario.robot))

    @property
    def outcome(self) -> str:
        """`success`, or the reason in words."""
        return "success" if self.record.success else str(self.record.reason).replace("_", " ")

    @property
    def bins(self) -> tuple[Bin, Bin]:
        """Source bin and place bin."""
        return self.scenario.source_bin.build(SOURCE), self.scenario.place_bin.build(PLACE)

    @property
    def boxes(self) -> list[Box]:
        """Table and bins."""
        source, place = self.bins
        return [self.scenario.table.build(), *source.boxes(), *place.boxes()]

    @property
    def shapes(self) -> list[LinkShape]:
        """Of the arm; none where a floating gripper stood in for it."""
        return link_shapes(self.robot) if self.artefact.carrier == "arm" else []

    @cached_property
    def links(self) -> dict[str, Array]:
        """T_world_link (f, 4, 4) of every link of the arm at every frame."""
        return link_poses(self.robot, self.artefact.motion.q) if self.artefact.carrier == "arm" else {}

    @cached_property
    def Ts_world_tool(self) -> Array:
        """(f, 4, 4) of the TCP at every frame."""
        q = self.artefact.motion.q
        flange = forward(self.robot, q) if self.artefact.carrier == "arm" else floating_flange(q)
        return flange @ self.gripper.T_flange_tool

    @cached_property
    def points(self) -> Array:
        """Measured points (n, 3) in the world."""
        a = self.artefact
        return DepthFrame(a.depth, a.intrinsics, a.T_world_camera).points_world()

    @cached_property
    def errors_mm(self) -> Array:
        """(k,) mean distance in [mm] of each estimate's CAD from that of the nearest true workpiece."""
        truth = self.artefact.motion.parts_at(0)
        found = [nearest_true(T, truth, self.workpiece)[1] for T in self.artefact.Ts_world_estimate]
        return 1000 * np.array(found)

    @property
    def wrong(self) -> np.ndarray:
        """(k,) bool: the estimate is out of the workpiece's tolerance."""
        return self.errors_mm > 1000 * self.workpiece.tolerance
