"""The 3-D scene of the grasp editor: workpiece, grasps, handle, ghosts, and the film of a trial."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import trimesh

from pickproof.cell.frames import Array, invert, make_transform
from pickproof.cell.grippers.base import Gripper, ToolLink
from pickproof.cell.workpiece.collision_pieces import CollisionBox
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.grasping.grasp_points import GraspPoint, first_pose, opening
from pickproof.scenarios.grasp_editor.film import Outcome
from pickproof.scenarios.grasp_editor.snapping import AXES, Plane, frame_of
from pickproof.scenarios.replay.viser_scene import add_box, move, pose_of

PART, OTHER, OFF = (205, 170, 110), (110, 140, 180), (170, 170, 170)
GOOD, BAD, BODY, GHOST, TAKEN = (40, 150, 90), (210, 60, 50), (60, 62, 68), (90, 160, 200), (214, 120, 44)
BLACK, PIXELS = (20, 20, 20), "screen"
AXIS_COLOURS = ((200, 60, 50), (60, 150, 60), (60, 90, 200))


class EditorScene:
    """Draws on a viser server; everything of the workpiece hangs below `/part`, in its CAD frame.

    Args:
        dragged: called with T_part_grip (4, 4) and the phase (start, update, end) while the handle is dragged.
        clicked: called with the index of a grasp that was clicked.
    """

    def __init__(
        self,
        server: Any,
        workpiece: Workpiece,
        gripper: Gripper,
        planes: Sequence[Plane],
        dragged: Callable[[Array, str], None],
        clicked: Callable[[int], None],
    ) -> None:
        self._server, self._workpiece, self._gripper, self._clicked = server, workpiece, gripper, clicked
        self._size = float(np.linalg.norm(workpiece.extents))
        scene, mesh = server.scene, workpiece.mesh
        far = max(self._size, 0.06)
        server.initial_camera.position = (0.8 * far, -1.3 * far, 1.1 * far)
        server.initial_camera.look_at = (0.0, 0.0, 0.2 * far)
        self._part = scene.add_frame("/part", show_axes=False)
        scene.add_mesh_simple("/part/cad", mesh.vertices, mesh.faces, color=PART, flat_shading=True)
        self._floor = scene.add_grid("/floor", 6 * far, 6 * far, cell_size=0.01, section_size=0.1, visible=False)
        self._axes(planes)
        fingers = max(0.4 * self._size, 0.03)
        self.handle = scene.add_transform_controls("/part/handle", scale=fingers, depth_test=False)
        self.handle.on_update(lambda event: dragged(handle_pose(event.target), event.phase))
        self._tool = scene.add_frame("/part/tool", show_axes=False)
        body = _body_mesh(gripper)
        self._body = scene.add_mesh_simple("/part/tool/body", body.vertices, body.faces, color=BODY, opacity=0.35)
        self._fingers = _add_fingers(scene, "/part/tool", gripper, GOOD, 0.75)
        self._ghosts: Any = None
        self._grasps: list[Any] = []
        self._film: list[Any] = []
        self._lying = False
        self._views: dict[int, tuple[Array, Array]] = {}
        self._film_tool: Any = None
        self._film_fingers: list[Any] = []
        self.show_bodies, self.show_others, self.show_ghosts = False, True, True

    def _axes(self, planes: Sequence[Plane]) -> None:
        scene, half = self._server.scene, 0.6 * self._size
        scene.add_frame("/part/symmetry", show_axes=False)
        symmetry = self._workpiece.symmetry
        for i, degrees in enumerate(symmetry.degrees):
            if degrees <= 0:
                continue
            end = half * np.eye(3)[i]
            scene.add_line_segments(
                f"/part/symmetry/{AXES[i]}",
                np.array([[-end, end]]),
                AXIS_COLOURS[i],
                thickness=3.0,
                thickness_units=PIXELS,
            )
            text = "any angle" if i == symmetry.infinite_axis else f"every {degrees:g} deg"
            scene.add_label(f"/part/symmetry/{AXES[i]}_name", f"{AXES[i]}: {text}", position=end)
        scene.add_icosphere("/part/symmetry/com", 0.015 * self._size, color=BLACK, position=self._workpiece.com)
        com = np.asarray(self._workpiece.com)
        below = com - (0.0, 0.0, half)  # the ball is inside most workpieces: a line leads to it
        line = np.array([[com, below]])
        scene.add_line_segments("/part/symmetry/com_line", line, BLACK, thickness=2.0, thickness_units=PIXELS)
        scene.add_label("/part/symmetry/com_name", "centre of mass", position=below, font_screen_scale=0.8)
        scene.add_frame("/part/planes", show_axes=False, visible=False)
        for k, plane in enumerate(planes):
            n = np.asarray(plane.normal)
            R = trimesh.geometry.align_vectors((0, 0, 1), n)[:3, :3]
            T = make_transform(R, plane.offset * n)
            scene.add_box(
                f"/part/planes/{k}", color=GHOST, dimensions=(2 * half, 2 * half, 2e-4), opacity=0.15, **pose_of(T)
            )

    def switch(self, name: str, on: bool) -> None:
        """Show or hide the nodes below `/part/NAME`."""
        self._server.scene.get_handle_by_name(f"/part/{name}").visible = on

    def lie(self, T_world_part: Array | None) -> None:
        """Show the workpiece as it lies at T_world_part (4, 4), on a floor; None for the CAD frame."""
        move(self._part, np.eye(4) if T_world_part is None else T_world_part)
        self._lying = self._floor.visible = T_world_part is not None

    def draw_grasps(self, points: Sequence[GraspPoint], selected: int) -> None:
        """Every other grasp with the gripper at its opening, and a ball to click at the root of its fingers."""
        for handle in self._grasps:
            handle.remove()
        self._grasps = []
        for i, point in enumerate(points if self.show_others else ()):
            if i == selected or (point.gripper not in (None, self._gripper.name)):
                continue
            mesh = _gripper_mesh(self._gripper, opening(point), self.show_bodies)
            handle = self._server.scene.add_mesh_simple(
                f"/part/grasps/{i}", mesh.vertices, mesh.faces, color=OTHER if point.enabled else OFF,
                opacity=0.3 if point.enabled else 0.12, **pose_of(first_pose(point)),
            )  # fmt: skip
            self._grasps.append(handle)
            # only what can be clicked keeps the mouse from the handle, so the fingers cannot
            length = _finger_length(self._gripper)
            ball = self._server.scene.add_icosphere(
                f"/part/balls/{i}", 0.03 * self._size, color=OTHER if point.enabled else OFF,
                position=(first_pose(point) @ (0.0, 0.0, -length, 1.0))[:3],
            )  # fmt: skip
            ball.on_click(lambda _, i=i: self._clicked(i))
            self._grasps.append(ball)

    def draw_selected(self, point: GraspPoint, good: bool, with_handle: bool) -> None:
        """The grasp that is being edited, its ghosts, and where wanted the handle at it."""
        T = first_pose(point)
        with self._server.atomic():
            move(self._tool, T)
            for handle, link in zip(self._fingers, self._gripper.links(), strict=True):
                handle.position = _shift(link, opening(point))
                handle.color = GOOD if good else BAD
            if with_handle:
                move(self.handle, frame_of(point))
        self._draw_ghosts(point, T)

    def _draw_ghosts(self, point: GraspPoint, T: Array) -> None:
        rotations = self._workpiece.symmetry.rotations()
        shown = self.show_ghosts and point.symmetry and len(rotations) > 1
        if not shown:
            if self._ghosts is not None:
                self._ghosts.visible = False
            return
        Ts = make_transform(rotations[1:]) @ T
        if self._ghosts is None:
            mesh = _gripper_mesh(self._gripper, opening(point), False)
            self._ghosts = self._server.scene.add_batched_meshes_simple(
                "/part/ghosts", mesh.vertices, mesh.faces, np.tile(pose_of(T)["wxyz"], (len(Ts), 1)), Ts[:, :3, 3],
                batched_colors=GHOST, opacity=0.25, cast_shadow=False, lod="off",
            )  # fmt: skip
        self._ghosts.visible = True
        self._ghosts.batched_wxyzs = np.stack([pose_of(t)["wxyz"] for t in Ts])
        self._ghosts.batched_positions = Ts[:, :3, 3]

    def show_film(self, outcome: Outcome | None) -> None:
        """Show the trial of a grasp, or the workpiece for editing."""
        for handle in self._film:
            handle.remove()
        self._film = []
        self._part.visible = outcome is None
        if outcome is None or outcome.film is None:
            self._floor.visible = self._lying
            self._look_back()
            return
        self._look_at(outcome.film.Ts_world_tool[:, :3, 3])
        scene, mesh = self._server.scene, self._workpiece.mesh
        self._floor.visible = outcome.bin is None
        if outcome.bin is not None:
            for box in outcome.bin.boxes():
                self._film.append(add_box(scene, f"/film/{box.name}", box, (88, 124, 160), opacity=0.35))
        self._film_parts = [
            scene.add_mesh_simple(
                f"/film/part_{i}",
                mesh.vertices,
                mesh.faces,
                color=TAKEN if i == outcome.part else PART,
                flat_shading=True,
            )
            for i in range(outcome.film.Ts_world_part.shape[1])
        ]
        self._film_tool = scene.add_frame("/film/tool", show_axes=False)
        body = _body_mesh(self._gripper)
        shell = scene.add_mesh_simple("/film/tool/body", body.vertices, body.faces, color=BODY, opacity=0.5)
        self._film_fingers = _add_fingers(scene, "/film/tool", self._gripper, (216, 108, 50), None)
        self._film += [*self._film_parts, shell, *self._film_fingers, self._film_tool]

    def _look_at(self, path: Array) -> None:
        """Turn every camera to where the tool goes, (n, 3) [m]."""
        middle, far = (path.min(axis=0) + path.max(axis=0)) / 2, float(np.ptp(path, axis=0).max()) + 2 * self._size
        for client in self._server.get_clients().values():
            camera = client.camera
            if camera.update_timestamp == 0:
                continue  # its pose is not known yet
            self._views.setdefault(client.client_id, (camera.position, camera.look_at))
            camera.position, camera.look_at = middle + far * np.array([0.55, -0.85, 0.45]), middle

    def _look_back(self) -> None:
        """Move every camera back to the view of its user."""
        for client in self._server.get_clients().values():
            if client.client_id in self._views:
                client.camera.position, client.camera.look_at = self._views.pop(client.client_id)

    def film_to(self, outcome: Outcome, frame: int) -> None:
        """Show one frame of the film."""
        film = outcome.film
        if film is None or not self._film:
            return
        with self._server.atomic():
            for handle, T in zip(self._film_parts, film.Ts_world_part[frame], strict=True):
                move(handle, T)
            move(self._film_tool, film.Ts_world_tool[frame])
            for handle, link in zip(self._film_fingers, self._gripper.links(), strict=True):
                handle.position = _shift(link, float(film.openings[frame]))


def handle_pose(handle: Any) -> Array:
    """T_part_grip (4, 4) of the handle."""
    w, x, y, z = handle.wxyz
    T = trimesh.transformations.quaternion_matrix((w, x, y, z))
    T[:3, 3] = handle.position
    return np.asarray(T)


def _finger_length(gripper: Gripper) -> float:
    """[m] of fingers, cups or magnets along the approach."""
    return float(gripper.finger_boxes(0.0)[0].size[2])


def _shift(link: ToolLink, opening: float) -> tuple[float, float, float]:
    """[m] in the tool frame by which a finger has moved from where its pads meet; faces of cups stay."""
    way = opening / 2 if link.name.startswith("finger_") and link.axis[0] else 0.0
    return (link.axis[0] * way, link.axis[1] * way, link.axis[2] * way)


def _link_mesh(gripper: Gripper, link: ToolLink) -> trimesh.Trimesh:
    """A finger, or all faces, in the tool frame at travel 0."""
    to_tool = invert(gripper.T_flange_tool)
    meshes = []
    for shape in link.shapes:
        if isinstance(shape, CollisionBox):
            meshes.append(trimesh.creation.box(shape.size, to_tool @ shape.T_part_box))
        else:
            T = to_tool @ shape.T_part_cylinder
            meshes.append(trimesh.creation.cylinder(shape.radius, shape.length, sections=24, transform=T))
    return _joined(meshes)


def _body_mesh(gripper: Gripper) -> trimesh.Trimesh:
    return _joined([trimesh.creation.box(box.size, box.T_world_box) for box in gripper.body_boxes()])


def _gripper_mesh(gripper: Gripper, opening: float, body: bool) -> trimesh.Trimesh:
    meshes = [_body_mesh(gripper)] if body else []
    for link in gripper.links():
        meshes.append(_link_mesh(gripper, link).apply_translation(_shift(link, opening)))
    return _joined(meshes)


def _add_fingers(
    scene: Any, above: str, gripper: Gripper, colour: tuple[int, int, int], opacity: float | None
) -> list[Any]:
    handles = []
    for link in gripper.links():
        mesh = _link_mesh(gripper, link)
        handles.append(
            scene.add_mesh_simple(f"{above}/{link.name}", mesh.vertices, mesh.faces, color=colour, opacity=opacity)
        )
    return handles


def _joined(meshes: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    mesh: Any = trimesh.util.concatenate(meshes)
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
