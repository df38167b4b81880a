"""The heap against which grasps are checked: measured by the camera, or, with the grasp oracle, the true one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from pickproof.cell.frames import Array, apply
from pickproof.cell.physics.observation import Snapshot
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.grasping.candidates import GraspCandidate
from pickproof.scenarios.picking.cell_model import CellModel
from pickproof.scenarios.picking.grasp_oracle import GraspOracle
from pickproof.scenarios.picking.heap_heightmap import scene_points, true_points
from pickproof.scenarios.picking.stages import Estimates

KNOWN_SCORE = 0.7
"""Score from which the surface of an estimate counts as an obstacle for the gripper."""
KNOWN_SPACING, KNOWN_SAMPLES = 0.006, (800, 12_000)  # [m] between such points, and how many there are of one body


class HeapKnowledge(Protocol):
    """Knowledge about the heap."""

    def points(self, cell: CellModel, frame: DepthFrame, estimates: Estimates) -> Array:
        """Points (n, 3) in the world that the gripper must avoid, without those of the bin."""
        ...

    def refuses(self, candidate: GraspCandidate) -> str:
        """Why a grasp that can be reached would not hold; empty where nothing is known against it."""
        ...

    def close(self) -> None:
        """Free the resources."""
        ...


class MeasuredHeap:
    """The heap from the camera and the estimates of perception."""

    def points(self, cell: CellModel, frame: DepthFrame, estimates: Estimates) -> Array:
        """Measured points, and points on the hidden sides of workpieces.

        An accepted estimate gives the whole surface of a workpiece; without it a tilted finger could hit its hidden
        side.
        """
        known = estimates.Ts_world_part[estimates.scores >= KNOWN_SCORE]
        samples = int(np.clip(cell.workpiece.mesh.area / KNOWN_SPACING**2, *KNOWN_SAMPLES))
        surface = cell.workpiece.sample_surface(samples, seed=8)[0]
        hidden = apply(known, surface).reshape(-1, 3)
        return np.concatenate([scene_points(cell, frame), hidden])

    def refuses(self, candidate: GraspCandidate) -> str:
        """Always empty: whether a grasp holds is not known."""
        return ""

    def close(self) -> None:
        """See `HeapKnowledge.close`."""
        return


class TrueHeap:
    """The grasp oracle: true poses of all workpieces, and a second physics in which a grasp is tried first."""

    def __init__(self, oracle: GraspOracle, observe: Callable[[], Snapshot]) -> None:
        self._oracle, self._observe = oracle, observe

    def points(self, cell: CellModel, frame: DepthFrame, estimates: Estimates) -> Array:
        """Points on the workpieces where they truly are."""
        return true_points(cell, self._observe())

    def refuses(self, candidate: GraspCandidate) -> str:
        """The result of the trial in the second physics."""
        return self._oracle.refuses(candidate, self._observe())

    def close(self) -> None:
        """See `HeapKnowledge.close`."""
        self._oracle.close()
