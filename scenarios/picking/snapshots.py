"""Pictures of an attempt as PNG: the depth image with poses, and the cell at stages of the pick."""

from __future__ import annotations

import cv2
import numpy as np

from pickproof.cell.frames import Array, apply, invert
from pickproof.cell.physics.picture import cell_picture
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.grasping.candidates import GraspCandidate
from pickproof.scenarios.picking.stages import Considered, Estimates
from pickproof.scenarios.picking.workcell import Workcell

CHOSEN, OTHERS, TOOL = (60, 220, 60), (255, 170, 40), (60, 60, 255)  # BGR


class AttemptPictures:
    """Pictures of one attempt; nothing is taken where the cell keeps none.

    Args:
        every_stage: also of each stage of the motion; else of a failure alone, after it.

    Attributes:
        taken: name -> PNG.
    """

    def __init__(self, cell: Workcell, every_stage: bool) -> None:
        self._cell, self._every_stage = cell, cell.pictures and every_stage
        self.taken: dict[str, bytes] = {}

    def stage(self, name: str) -> None:
        """The cell at a stage of the motion: `grasp`, `lift` or `place`."""
        if self._every_stage:
            self.taken[name] = cell_snapshot(self._cell, close_up=name == "grasp")

    def finish(self, considered: Considered, success: bool) -> None:
        """At the end of the attempt: the depth image with poses, and the cell after a failure."""
        if self._every_stage or (self._cell.pictures and not success):
            estimates, chosen = considered.estimates, considered.decision.candidate
            self.taken["depth"] = depth_picture(self._cell, considered.frame, estimates, chosen)
            if not success:
                self.taken["after"] = cell_snapshot(self._cell)


def cell_snapshot(cell: Workcell, close_up: bool = False) -> bytes:
    """The cell as it stands as PNG: both bins, or the source bin close up."""
    x, y, z = cell.source.position
    if close_up:
        eye, target = (x + 0.22, y - 0.34, z + 0.26), (x, y, z + 0.04)
    else:
        x, y, z = (np.array(cell.source.position) + cell.place.position) / 2
        eye, target = (x + 0.6, y - 0.75, z + 0.65), (x - 0.04, y + 0.02, z + 0.1)
    return png(cell_picture(cell.world, eye, target, 560, 420)[:, :, ::-1])


def png(image_bgr: np.ndarray) -> bytes:
    """An image (h, w, 3) uint8 as PNG."""
    return bytes(cv2.imencode(".png", image_bgr, [cv2.IMWRITE_PNG_COMPRESSION, 6])[1])


def depth_picture(cell: Workcell, frame: DepthFrame, estimates: Estimates, chosen: GraspCandidate | None) -> bytes:
    """Measured depth in grey, missing pixels black, estimated poses as CAD outlines, the chosen grasp in red."""
    depth = frame.depth
    low, high = np.percentile(depth[depth > 0], [0.5, 99.5]) if (depth > 0).any() else (0.0, 1.0)
    grey = np.where(depth > 0, 70 + 175 * np.clip((high - depth) / max(high - low, 1e-6), 0, 1), 0).astype(np.uint8)
    image = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    T_camera_world = invert(frame.T_world_camera)
    edges = cell.workpiece.mesh.face_adjacency_edges[cell.workpiece.mesh.face_adjacency_angles > 0.5]
    for k, T_world_part in enumerate(estimates.Ts_world_part):
        mine = chosen is not None and chosen.estimate == k
        points = apply(T_camera_world @ T_world_part, cell.workpiece.vertices)
        _lines(image, frame, points[edges], CHOSEN if mine else OTHERS, 2 if mine else 1)
    if chosen is not None:
        for box in cell.gripper.finger_boxes(chosen.opening):
            half = np.asarray(box.size) / 2
            loop = np.array([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]]) * half
            tips = apply(T_camera_world @ chosen.T_world_tool @ box.T_world_box, loop)
            _lines(image, frame, np.stack([tips, np.roll(tips, -1, axis=0)], axis=1), TOOL, 2)
    return png(image)


def _lines(image: np.ndarray, frame: DepthFrame, ends: Array, colour: tuple[int, int, int], width: int) -> None:
    pixels = np.rint(frame.intrinsics.project(ends)).astype(int)
    for a, b in pixels:
        cv2.line(image, tuple(map(int, a)), tuple(map(int, b)), colour, width, cv2.LINE_AA)
