"""The interactive page of a replay: the cell in 3-D, every grasp coloured by its verdict, the motion on a slider."""

from __future__ import annotations

import threading
import time
from collections import Counter
from typing import Any

import numpy as np
import trimesh

from pickproof.cell.frames import Array, to_quat_xyzw
from pickproof.grasping.verdict import CHOSEN, MEANING, Verdict
from pickproof.robots.kinematics.links import LinkShape
from pickproof.scenarios.replay.data import Replayed
from pickproof.scenarios.replay.viser_scene import HOST, add_box, move, pose_of, serve

RANKED = "ranked candidates"
COLOURS: dict[str, tuple[int, int, int]] = {
    CHOSEN: (31, 160, 90),
    Verdict.OUTRANKED: (120, 150, 190),
    Verdict.TILT: (176, 158, 126),
    Verdict.GRIPPER_BIN: (214, 120, 44),
    Verdict.GRIPPER_HEAP: (200, 60, 50),
    Verdict.PATH_BLOCKED: (150, 60, 160),
    Verdict.HELD_BIN: (120, 70, 40),
    Verdict.NO_IK: (60, 60, 70),
    Verdict.JOINT_LIMIT: (90, 90, 105),
    Verdict.SINGULARITY: (110, 110, 140),
    Verdict.AVOIDED: (190, 170, 60),
    Verdict.TOLERANCE: (230, 190, 60),
    Verdict.SCORE: (150, 150, 150),
    Verdict.TRIAL: (220, 60, 140),
}
BIN, TABLE, TOOL = (88, 124, 160), (204, 199, 189), (60, 62, 68)
PART, RIGHT, WRONG = (205, 170, 110), (40, 150, 90), (210, 60, 50)
NEAR = 0.012  # [m] between a click's ray and the grasp that it means
MAX_POINTS = 60_000


class ReplayPage:
    """A viser server on the loopback interface that shows one attempt; `close` it after use.

    Attributes:
        url: where the page is.
    """

    def __init__(self, shown: Replayed, port: int = 8080) -> None:
        self._shown = shown
        self._lock = threading.Lock()
        self._frame, self._playing, self._closed = -1, False, False
        self._server = serve(f"attempt {shown.index}", port)
        self.url = f"http://{HOST}:{self._server.get_port()}"
        x, y, z = shown.scenario.source_bin.position
        self._server.initial_camera.position = (x + 0.24, y - 0.36, z + 0.40)
        self._server.initial_camera.look_at = (x - 0.02, y - 0.02, z + 0.04)
        self._scene()
        self._panel()
        self._show_grasps(RANKED)
        self._go_to(0)
        threading.Thread(target=self._play, daemon=True).start()

    def close(self) -> None:
        """Stop the server."""
        self._closed = True
        self._server.stop()

    def _scene(self) -> None:
        shown, scene = self._shown, self._server.scene
        for box in shown.boxes:
            add_box(scene, f"/cell/{box.name}", box, TABLE if box.name == "table" else BIN)
        self._links = {name: scene.add_frame(f"/arm/{name}", show_axes=False) for name in shown.links}
        for i, shape in enumerate(shown.shapes):
            _add_shape(scene, f"/arm/{shape.link}/{i}", shape)
        self._tool = scene.add_frame("/gripper", show_axes=True, axes_length=0.03, axes_radius=0.001)
        for box in shown.gripper.body_boxes():
            add_box(scene, f"/gripper/{box.name}", box, TOOL)
        self._fingers = [
            add_box(scene, f"/gripper/{box.name}", box, (216, 108, 50)) for box in shown.gripper.finger_boxes(0.0)
        ]
        mesh = shown.workpiece.mesh
        n = shown.artefact.motion.poses.shape[1]
        self._parts = [
            scene.add_mesh_simple(f"/workpieces/{i}", mesh.vertices, mesh.faces, color=PART, flat_shading=True)
            for i in range(n)
        ]
        for k, T in enumerate(shown.artefact.Ts_world_estimate):
            colour = WRONG if shown.wrong[k] else RIGHT
            scene.add_mesh_simple(
                f"/estimates/{k}", mesh.vertices, mesh.faces, color=colour, wireframe=True, **pose_of(T)
            )
        points = shown.points
        step = max(1, len(points) // MAX_POINTS)
        height = (points[::step, 2] - points[:, 2].min()) / max(float(np.ptp(points[:, 2])), 1e-6)
        grey = np.repeat((60 + 150 * height[:, None]).astype(np.uint8), 3, axis=1)
        self._cloud = scene.add_point_cloud("/cloud", points[::step].astype(np.float32), grey, point_size=0.0008)

    def _panel(self) -> None:
        shown, gui = self._shown, self._server.gui
        r, motion = shown.record, shown.artefact.motion
        error = "" if r.error_mm is None else f", chosen estimate off by {r.error_mm:.2f} mm and {r.error_deg:.1f} deg"
        gui.add_markdown(
            f"## Attempt {shown.index}: {shown.outcome}\n\nseed {r.seed}, attempt {r.attempt} of its bin; "
            f"{r.parts_in_bin_before} workpieces in the bin, {r.n_estimates} estimates{error}; "
            f"{'grasp ' + r.grasp if r.grasp else 'the arm did not move'}"
        )
        end = max(float(motion.time[-1]), 0.02)
        self._slider: Any = gui.add_slider("time [s]", 0.0, round(end, 2), 0.02, 0.0, disabled=len(motion.time) < 2)
        self._slider.on_update(lambda _: self._go_to(int(np.searchsorted(motion.time, self._slider.value - 1e-3))))
        self._button = gui.add_button("Play", disabled=len(motion.time) < 2)
        self._button.on_click(lambda _: self._toggle())
        with gui.add_folder("Show"):
            for label, names, first in (
                ("workpieces, as they truly are", [p.name for p in self._parts], True),
                ("estimates (red: out of tolerance)", _names("/estimates", len(shown.wrong)), True),
                ("measured points", ["/cloud"], False),
                ("arm", [f"/arm/{name}" for name in shown.links], True),
            ):
                self._add_switch(label, names, first)
        with gui.add_folder("Grasps"):
            options = [RANKED, *(f"estimate {k}" for k in range(len(shown.wrong))), "none"]
            choice = gui.add_dropdown("grasps of", options, initial_value=RANKED)
            choice.on_update(lambda _: self._show_grasps(choice.value))
            self._legend = gui.add_markdown("")
            self._said = gui.add_markdown("Click a grasp to see why it was taken or not.")

    def _add_switch(self, label: str, names: list[str], first: bool) -> None:
        handles = [h for name in names if (h := self._handle(name)) is not None]
        box = self._server.gui.add_checkbox(label, first)

        def switch(_: Any = None) -> None:
            for handle in handles:
                handle.visible = box.value

        box.on_update(switch)
        switch()

    def _handle(self, name: str) -> Any:
        return self._server.scene.get_handle_by_name(name)

    def _show_grasps(self, choice: str) -> None:
        """Every grasp of what was chosen, coloured by its verdict; a click names it."""
        rows = self._rows(choice)
        self._server.scene.remove_by_name("/grasps")
        self._server.scene.remove_by_name("/selected")
        counts = Counter(row["verdict"] for row in rows)
        lines = [f"{_dot(v)} **{n}** {v.replace('_', ' ')}: {_meaning(v)}" for v, n in counts.most_common()]
        self._legend.content = "\n\n".join(lines) or "None."
        if not rows:
            return
        Ts = np.stack([row["T_world_tool"] for row in rows])
        scales = np.array([(max(row["opening"], 1e-3), 1.0, 1.0) for row in rows])
        colours = np.array([COLOURS.get(row["verdict"], (128, 128, 128)) for row in rows], dtype=np.uint8)
        glyph = _glyph()
        handle = self._server.scene.add_batched_meshes_simple(
            "/grasps",
            glyph.vertices,
            glyph.faces,
            np.roll(to_quat_xyzw(Ts), 1, axis=1),
            Ts[:, :3, 3],
            batched_scales=scales,
            batched_colors=colours,
            cast_shadow=False,
            lod="off",
        )

        @handle.on_click
        def _(event: Any) -> None:
            at = _hit(Ts, np.array(event.ray_origin), np.array(event.ray_direction))
            if at is not None:
                self._select(rows[at])

    def _rows(self, choice: str) -> list[dict[str, Any]]:
        a = self._shown.artefact
        if choice == RANKED:
            return list(a.candidates[::-1])  # the best are drawn last, on top
        if not choice.startswith("estimate "):
            return []
        k = int(choice.split()[1])
        ruled_out = [
            {
                "estimate": k,
                "grasp": a.grasps[i],
                "T_world_tool": a.Ts_world_estimate[k] @ a.Ts_part_tool[i],
                "opening": float(a.openings[i]),
                "verdict": str(a.verdicts[k, i]),
            }
            for i in np.flatnonzero(a.verdicts[k] != "")
        ]
        return ruled_out + [c for c in a.candidates if c["estimate"] == k]

    def _select(self, row: dict[str, Any]) -> None:
        """Show the whole gripper at a grasp, and why it was taken or not."""
        lines = [f"**{row['grasp']}** on estimate {row['estimate']}: **{row['verdict'].replace('_', ' ')}**"]
        lines.append(row.get("detail") or _meaning(row["verdict"]))
        if "rank" in row:
            terms = ", ".join(f"{name} {value:.2f}" for name, value in row["terms"].items())
            lines.append(f"rank {row['rank']:.2f}; terms before weights: {terms}")
        self._said.content = "\n\n".join(lines)
        scene = self._server.scene
        scene.remove_by_name("/selected")
        scene.add_frame("/selected", show_axes=False, **pose_of(row["T_world_tool"]))
        for box in self._shown.gripper.boxes(row["opening"]):
            add_box(scene, f"/selected/{box.name}", box, COLOURS.get(row["verdict"], (128, 128, 128)), opacity=0.55)

    def _toggle(self) -> None:
        self._playing = not self._playing
        if self._playing and self._frame >= len(self._shown.artefact.motion.time) - 1:
            self._slider.value = 0.0
        self._button.label = "Pause" if self._playing else "Play"

    def _play(self) -> None:
        times = self._shown.artefact.motion.time
        while not self._closed:
            time.sleep(0.04)
            if not self._playing:
                continue
            after = min(float(self._slider.value) + 0.04, float(times[-1]))
            self._slider.value = after
            if after >= float(times[-1]) - 1e-6:
                self._toggle()

    def _go_to(self, frame: int) -> None:
        motion = self._shown.artefact.motion
        frame = int(np.clip(frame, 0, len(motion.time) - 1))
        with self._lock, self._server.atomic():
            moved = np.ones(len(self._parts), bool)
            if self._frame >= 0:
                moved = (motion.poses[frame] != motion.poses[self._frame]).any(axis=1)
            Ts = motion.parts_at(frame)
            for i in np.flatnonzero(moved):
                move(self._parts[i], Ts[i])
            for name, link in self._links.items():
                move(link, self._shown.links[name][frame])
            move(self._tool, self._shown.Ts_world_tool[frame])
            boxes = self._shown.gripper.finger_boxes(float(motion.opening[frame]))
            for finger, box in zip(self._fingers, boxes, strict=True):
                move(finger, box.T_world_box)
            self._frame = frame


def _glyph() -> trimesh.Trimesh:
    """Two fingers, a bar and a stem of a gripper whose opening is 1, as thin as can still be seen."""
    boxes = (
        ((0.10, 0.001, 0.020), (-0.5, 0.0, -0.010)),
        ((0.10, 0.001, 0.020), (0.5, 0.0, -0.010)),
        ((1.10, 0.001, 0.001), (0.0, 0.0, -0.020)),
        ((0.10, 0.001, 0.020), (0.0, 0.0, -0.030)),
    )
    parts = [trimesh.creation.box(size, trimesh.transformations.translation_matrix(at)) for size, at in boxes]
    mesh: Any = trimesh.util.concatenate(parts)
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def _hit(Ts_world_tool: Array, origin: Array, direction: Array) -> int | None:
    """The grasp (of (n, 4, 4)) whose fingers a ray passes nearest, None where all are farther than NEAR [m]."""
    middle = Ts_world_tool[:, :3, 3] - 0.015 * Ts_world_tool[:, :3, 2]
    along = (middle - origin) @ direction
    away = np.linalg.norm(middle - origin - along[:, None] * direction, axis=1)
    best = int(np.argmin(away))
    return best if away[best] < NEAR else None


def _add_shape(scene: Any, name: str, shape: LinkShape) -> None:
    if shape.kind == "box":
        mesh = trimesh.creation.box(shape.size)
    else:
        mesh = trimesh.creation.cylinder(radius=shape.size[0], height=shape.size[1], sections=32)
    colour = tuple(int(255 * c) for c in shape.rgb)
    scene.add_mesh_simple(name, mesh.vertices, mesh.faces, color=colour, **pose_of(shape.T_link_shape))


def _names(folder: str, n: int) -> list[str]:
    return [f"{folder}/{k}" for k in range(n)]


def _meaning(verdict: str) -> str:
    return "picked" if verdict == CHOSEN else MEANING[Verdict(verdict)] if verdict in list(Verdict) else verdict


def _dot(verdict: str) -> str:
    r, g, b = COLOURS.get(verdict, (128, 128, 128))
    return f'<span style="color: rgb({r},{g},{b})">&#9632;</span>'
