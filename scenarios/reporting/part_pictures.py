"""Pictures of a part as PNG: axes, resting poses, collision pieces, grasps; parallel projection."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pickproof.cell.frames import Array, apply, make_transform
from pickproof.cell.geometry.bin import Box
from pickproof.cell.geometry.raycast import make_caster
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.symmetry.symmetry_search import FoundSymmetry
from pickproof.cell.workpiece.collision_pieces import Piece
from pickproof.cell.workpiece.piece_errors import piece_mesh
from pickproof.cell.workpiece.resting_poses import Resting
from pickproof.grasping.grasp_points import GraspPoint, opening

STEEL, TOOL, FLOOR = (0.62, 0.67, 0.73), (0.93, 0.55, 0.20), (0.88, 0.87, 0.84)
AXES = {"x": "#c0392b", "y": "#2e8b57", "z": "#2c5fb3"}
LIGHT = np.array([-0.35, -0.55, 0.76])
PIXELS = 420


@dataclass(frozen=True)
class Body:
    """A mesh in [m] and its colour."""

    vertices: Array
    faces: np.ndarray
    colour: tuple[float, float, float]


def axes_picture(mesh: trimesh.Trimesh, found: FoundSymmetry, degrees: Sequence[float]) -> bytes:
    """The part with the axes of its frame, those of symmetry strong, and nearly symmetric ones dashed."""
    body = Body(np.asarray(mesh.vertices), np.asarray(mesh.faces), STEEL)
    reach = 0.62 * float(mesh.extents.max())
    fig = Figure(figsize=(9.6, 4.6))
    panels = fig.subplots(1, 2)
    for panel, eye in zip(panels, ((1.0, -1.4, 0.9), (-1.3, -0.9, 0.5)), strict=True):
        view = _View(eye, [body])
        panel.imshow(view.shade(), extent=view.extent)
        for k, name in enumerate("xyz"):
            strong = degrees[k] > 0
            _arrow(panel, view, np.eye(3)[k] * reach, AXES[name], f"{name}{_said(degrees[k])}", 2.6 if strong else 0.9)
        for turn in found.near:
            label = f"nearly {_order(turn.order)}"
            _arrow(panel, view, 0.9 * reach * turn.direction, "#8e44ad", label, 1.2, dashed=True)
        panel.set_axis_off()
    return _png(fig)


def resting_picture(mesh: trimesh.Trimesh, resting: Sequence[Resting]) -> bytes:
    """The resting poses side by side, with their probabilities."""
    shown = list(resting)[:6]
    fig = Figure(figsize=(2.4 * max(len(shown), 3), 2.5))
    panels = fig.subplots(1, len(shown), squeeze=False)
    reach = 0.75 * float(np.linalg.norm(mesh.extents))
    ground = trimesh.creation.box((2 * reach, 2 * reach, 1e-4), make_transform(t=(0, 0, -1e-4)))
    for panel, pose in zip(panels[0], shown, strict=True):
        bodies = [Body(apply(pose.T_plane_part, np.asarray(mesh.vertices)), np.asarray(mesh.faces), STEEL)]
        view = _View((1.0, -1.4, 0.9), bodies, [Body(np.asarray(ground.vertices), np.asarray(ground.faces), FLOOR)])
        panel.imshow(view.shade(), extent=view.extent)
        panel.set_title(f"{100 * pose.probability:.0f} %", fontsize=11)
        panel.set_axis_off()
    return _png(fig)


def pieces_picture(mesh: trimesh.Trimesh, pieces: Sequence[Piece]) -> bytes:
    """The part, and beside it its collision pieces, each in a colour of its own."""
    colours = colormaps["tab20"](np.arange(len(pieces)) % 20)[:, :3]
    made = [piece_mesh(piece) for piece in pieces]
    solid = [Body(np.asarray(mesh.vertices), np.asarray(mesh.faces), STEEL)]
    parts = [Body(np.asarray(m.vertices), np.asarray(m.faces), tuple(c)) for m, c in zip(made, colours, strict=True)]
    fig = Figure(figsize=(9.6, 4.2))
    panels = fig.subplots(1, 2)
    for panel, bodies in zip(panels, (solid, parts), strict=True):
        view = _View((1.0, -1.4, 0.9), bodies)
        panel.imshow(view.shade(), extent=view.extent)
        panel.set_axis_off()
    return _png(fig)


def grasps_picture(mesh: trimesh.Trimesh, points: Sequence[GraspPoint], gripper: Gripper) -> bytes:
    """The part with the fingers or faces of the gripper at its best grasps."""
    shown = list(points)[:4]
    fig = Figure(figsize=(3.2 * max(len(shown), 2), 3.4))
    panels = fig.subplots(1, len(shown), squeeze=False)
    for panel, point in zip(panels[0], shown, strict=True):
        _draw_grasp(panel, mesh, _tool_pose(point), _fingers(point, gripper, point.width))
        panel.set_title(f"{point.name}: holds at {100 * point.robustness:.0f} % of errors", fontsize=9)
    return _png(fig)


def moved_picture(mesh: trimesh.Trimesh, before: GraspPoint, after: GraspPoint, gripper: Gripper) -> bytes:
    """A grasp before (left) and after it was moved, seen from the same side, the fingers as far open as they come."""
    fig = Figure(figsize=(4.0, 2.0))
    for panel, point in zip(fig.subplots(1, 2), (before, after), strict=True):
        _draw_grasp(panel, mesh, _tool_pose(before), _fingers(point, gripper, opening(point)), margin=1.8)
    return _png(fig)


def _fingers(point: GraspPoint, gripper: Gripper, wide: float) -> list[Body]:
    boxes = [_moved(box, _tool_pose(point)) for box in gripper.finger_boxes(wide)]
    return [Body(np.asarray(b.vertices), np.asarray(b.faces), TOOL) for b in boxes]


def _draw_grasp(
    panel: Axes, mesh: trimesh.Trimesh, T_part_tool: Array, fingers: Sequence[Body], margin: float = 1.35
) -> None:
    """The part and fingers, seen along the pads with the approach downwards."""
    part = Body(np.asarray(mesh.vertices), np.asarray(mesh.faces), STEEL)
    eye = -T_part_tool[:3, 2] * 0.5 + T_part_tool[:3, 1] * 1.2 + T_part_tool[:3, 0] * 0.35
    view = _View(tuple(eye), [part], fingers, -T_part_tool[:3, 2], margin)
    panel.imshow(view.shade(), extent=view.extent)
    panel.set_axis_off()


def _tool_pose(point: GraspPoint) -> Array:
    z, x = (np.asarray(v, dtype=np.float64) / np.linalg.norm(v) for v in (point.approach, point.closing))
    return make_transform(np.stack([x, np.cross(z, x), z], axis=1), np.asarray(point.centre) + point.depths[0] * z)


def _moved(box: Box, T_part_tool: Array) -> trimesh.Trimesh:
    return trimesh.creation.box(box.size, T_part_tool @ box.T_world_box)


class _View:
    """A parallel projection on all of `bodies`; `beside` is drawn too but does not widen the picture."""

    def __init__(
        self,
        eye: Sequence[float],
        bodies: Sequence[Body],
        beside: Sequence[Body] = (),
        up: Array | None = None,
        margin: float = 1.35,
    ) -> None:
        self._all = [*bodies, *beside]
        points = np.concatenate([body.vertices for body in bodies])
        self._middle = (points.min(axis=0) + points.max(axis=0)) / 2
        back = np.asarray(eye, dtype=np.float64) / np.linalg.norm(eye)
        right = np.cross(np.array([0.0, 0.0, 1.0]) if up is None else up, back)
        right /= np.linalg.norm(right)
        self._R = np.stack([right, np.cross(back, right), back])
        half = margin * float(np.abs(self.flat(points)).max())
        self.extent = (-half, half, -half, half)

    def flat(self, points: Array) -> Array:
        """Points (n, 3) in the picture (n, 2) [m]."""
        return ((points - self._middle) @ self._R.T)[:, :2]

    def shade(self) -> np.ndarray:
        """(PIXELS, PIXELS, 4), clear where nothing is."""
        counts = np.cumsum([0, *(len(body.vertices) for body in self._all)])
        vertices = np.concatenate([body.vertices for body in self._all])
        faces = np.concatenate([body.faces + n for body, n in zip(self._all, counts, strict=False)])
        colours = np.concatenate([np.tile(body.colour, (len(body.faces), 1)) for body in self._all])
        at = (np.arange(PIXELS) + 0.5) / PIXELS * 2 - 1
        x, y = np.meshgrid(at * self.extent[1], -at * self.extent[1])
        far = 4 * self.extent[1]
        origins = self._middle + np.stack([x.ravel(), y.ravel(), np.full(x.size, far)], axis=1) @ self._R
        hits = make_caster(vertices, faces).cast(origins, np.broadcast_to(-self._R[2], origins.shape))
        seen = hits.face >= 0
        corners = vertices[faces[hits.face[seen]]]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        normals *= np.sign(normals @ self._R[2])[:, None]
        light = 0.45 + 0.35 * np.clip(normals @ LIGHT, 0, 1) + 0.25 * np.clip(normals @ self._R[2], 0, 1)
        image = np.zeros((PIXELS * PIXELS, 4))
        image[seen, :3] = np.clip(colours[hits.face[seen]] * light[:, None] * 1.15, 0, 1)
        image[seen, 3] = 1.0
        return image.reshape(PIXELS, PIXELS, 4)


def _arrow(panel: Axes, view: _View, tip: Array, colour: str, label: str, width: float, dashed: bool = False) -> None:
    (x0, y0), (x1, y1) = view.flat(np.stack([-tip, tip]))
    panel.plot([x0, x1], [y0, y1], color=colour, lw=width, ls="--" if dashed else "-")
    panel.text(x1, y1, label, color=colour, fontsize=9, ha="center", va="bottom")


def _said(degrees: float) -> str:
    if degrees == 0:
        return ""
    return ": any angle" if degrees <= 5 else f": {degrees:.4g} deg"


def _order(order: int) -> str:
    return "any turn" if order == 0 else f"{360 / order:.4g} deg"


def _png(fig: Figure) -> bytes:
    out = io.BytesIO()
    fig.tight_layout()
    fig.savefig(out, format="png", dpi=110)
    return out.getvalue()
