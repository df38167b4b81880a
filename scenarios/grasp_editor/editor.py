"""`pickproof grasps edit`: the page on which grasps are moved, checked, tried in the physics and saved.

The document is the only state; the page shows it. During a drag a separate thread checks the newest pose; when the
handle is released, the drag becomes one change of the document. Physics runs in another thread.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from pickproof.cell.errors import PickproofError
from pickproof.cell.frames import Array
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.grasping.grasp_points import GraspPoint
from pickproof.scenarios.grasp_editor.document import Conflict, GraspDocument, begun_point
from pickproof.scenarios.grasp_editor.geometry_checks import GraspJudge
from pickproof.scenarios.grasp_editor.panel import AMBER, CAD, GREEN, HINTS, Panel
from pickproof.scenarios.grasp_editor.scene import EditorScene
from pickproof.scenarios.grasp_editor.snapping import Plane, SnapTargets, fields_of, frame_of, mirrored, squared
from pickproof.scenarios.grasp_editor.trial_runner import GraspTries
from pickproof.scenarios.pages.address import HOST, Address
from pickproof.scenarios.pages.viser_page import serve

POLL = 1.0  # [s] between checks of the file
REST = 0.4  # [s] after the last key before the typed text is used
TICK = 0.04  # [s] between checks during a drag, and between frames of a film
NOTICE = 8.0  # [s] for which a refusal is shown above the page


class GraspEditor:
    """The page and what it edits; `close` it after use.

    Args:
        token: that the address of the page contains; None draws one at random.

    Attributes:
        url: where the page is, with its token.
        document: the grasps.yaml.
        selected: index of the grasp that is edited.
    """

    def __init__(
        self,
        workpiece: Workpiece,
        gripper: Gripper,
        path: Path,
        port: int = 8080,
        host: str = HOST,
        token: str | None = None,
    ) -> None:
        self.workpiece, self.gripper = workpiece, gripper
        self.document = GraspDocument(path, workpiece, gripper)
        self.selected = 0
        self._judge, self._targets = GraspJudge(workpiece, gripper), SnapTargets.of(workpiece)
        self._lock = threading.RLock()
        self._drag: tuple[Array, str] | None = None
        self._typed: dict[str, Any] = {}
        self._typed_at = 0.0
        self._closed, self._told = False, False
        self._server, self.url = serve(f"{workpiece.name}: grasps", Address(host, port, token))
        planes = (*self._targets.centre_planes, *self._targets.symmetry_planes)
        self._scene = EditorScene(
            self._server, workpiece, gripper, self._targets.symmetry_planes, self._dragged, self.select
        )
        self._panel = Panel(self._server.gui, f"{workpiece.name} with {gripper.name}", planes, self)
        self._tries = GraspTries(workpiece, gripper, self._scene, self._panel, self._lock)
        self.show()
        self._threads = [threading.Thread(target=work, daemon=True) for work in (self._follow, self._watch_file)]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Stop the server and the physics; unsaved changes are lost."""
        self._closed = True
        for thread in self._threads:
            thread.join()
        self._tries.close()
        self._server.stop()

    @property
    def point(self) -> GraspPoint | None:
        """The grasp that is edited; None while the file cannot be read."""
        points = self.document.points
        return points[min(self.selected, len(points) - 1)] if points else None

    def show(self, keep: dict[str, Any] | None = None) -> None:
        """Show the document in page and scene, except the fields `keep` that a user is editing."""
        with self._lock:
            if self.document.error:
                self._panel.say(
                    f"The file cannot be edited: {self.document.error}. Correct it; the page reads it again."
                )
            points, point = self.document.points, self.point
            self._panel.fields.enable(point is not None)
            self._panel.forget_diff()
            if point is None:
                return
            self.selected = min(self.selected, len(points) - 1)
            self._panel.list_grasps(points, self.selected)
            self._panel.fields.show(point, keep)
            self._scene.draw_grasps(points, self.selected)
            self._judged(point, with_handle=True, all_poses=True)

    def _judged(self, point: GraspPoint, with_handle: bool, all_poses: bool = False) -> None:
        verdict = self._judge.judge(point)
        free = self._judge.free_poses(point) if all_poses else None
        self._panel.verdict(self._judge, verdict, point, free)
        self._scene.draw_selected(point, not self._judge.doubts(verdict, point), with_handle)

    def select(self, index: int) -> None:
        """Edit another grasp."""
        with self._lock:
            self._take_typed()
            self.selected = index
            self._panel.say("")
            self.show()

    def change(self, name: str, value: Any) -> None:
        """A user types; the text is used after a pause."""
        with self._lock:
            self._typed[name] = value
            self._typed_at = time.monotonic()

    def refuse(self, line: str) -> None:
        """Show why an input is refused, also where the top of the panel is scrolled away."""
        self._panel.say(line)
        for client in self._server.get_clients().values():
            client.add_notification("Not taken", line, color="red", auto_close_seconds=NOTICE)

    def view(self, name: str, on: bool) -> None:
        """Show or hide something of the scene."""
        with self._lock:
            if name in ("others", "bodies", "ghosts"):
                setattr(self._scene, f"show_{name}", on)
                self.show(self._typed)
            else:
                self._scene.switch(name, on)

    def lie(self, choice: str) -> None:
        """Show the workpiece in a resting pose."""
        with self._lock:
            self._scene.lie(None if choice == CAD else self._tries.resting[int(choice.rsplit(" ", 1)[1])])

    def mirror(self, plane: Plane) -> None:
        """Add the mirror image of the grasp at a plane."""
        point = self.point
        if point is not None:
            self._edit(lambda: self._add(mirrored(point, plane, f"{point.name}_mirrored")))

    def act(self, name: str) -> None:
        """A button: its label in lower case."""
        actions: dict[str, Any] = {
            "undo": self._undo,
            "redo": self._redo,
            "fit": self._fit,
            "add": lambda: self._add(begun_point(self.workpiece, self.gripper)),
            "duplicate": lambda: self._add(self.point),
            "delete": lambda: self.document.remove(self.selected),
            "up": lambda: self._shift(-1),
            "down": lambda: self._shift(1),
            "on / off": self._switch,
            "reload": self._reload,
        }
        others: dict[str, Any] = {
            "overwrite": lambda: self._save(True),
            "save": lambda: self._save(False),
            "show changes": self._show_changes,
            "back to editing": lambda: self._tries.stage(None),
            "another heap": self._tries.another_heap,
        }
        if name in actions:
            self._edit(actions[name])
        else:
            with self._lock:
                self._take_typed()
                self._guarded(others[name])

    def _edit(self, change: Any) -> None:
        with self._lock:
            self._take_typed()
            if self._guarded(change):
                self._tries.stage(None)
                self.show()

    def _guarded(self, change: Any) -> bool:
        """Run an action; returns whether it succeeded. Errors of the user are shown on the page."""
        self._panel.say("")
        try:
            change()
        except PickproofError as error:
            self.refuse(str(error))
            return False
        return True

    def _undo(self) -> None:
        if not self.document.can_undo:
            self._panel.say("There is nothing to undo.", AMBER)
        self._staying(self.document.undo)

    def _redo(self) -> None:
        if not self.document.can_redo:
            self._panel.say("There is nothing to redo.", AMBER)
        self._staying(self.document.redo)

    def _staying(self, change: Callable[[], None]) -> None:
        """Show a new text, with the same grasp selected as before."""
        name = self.point.name if self.point is not None else ""
        change()
        self.selected = next((i for i, p in enumerate(self.document.points) if p.name == name), self.selected)

    def _switch(self) -> None:
        if self.point is not None:
            self.document.change(self.selected, {"enabled": not self.point.enabled})

    def _add(self, point: GraspPoint | None) -> None:
        if point is None:
            return
        named = point.model_copy(update={"name": self.document.free_name(point.name)})
        self.selected = self.document.add(named, self.selected)

    def _shift(self, by: int) -> None:
        to = int(np.clip(self.selected + by, 0, len(self.document.points) - 1))
        self.document.move(self.selected, to)
        self.selected = to
        if self.point is not None:
            self._panel.say(f"{self.point.name} is number {to + 1} of {len(self.document.points)}.", GREEN)

    def _fit(self) -> None:
        if self.point is not None:
            self.document.change(self.selected, self._judge.fitted(self.point))

    def _take_typed(self) -> None:
        """Make the typed text a change of the document."""
        typed, self._typed = self._typed, {}
        if not typed or self.point is None:
            return
        typed |= squared(self.point, typed)
        if self._guarded(lambda: self.document.change(self.selected, typed)):
            self.show(typed)

    def _dragged(self, T_part_grip: Array, phase: str) -> None:
        with self._lock:
            ended = self._drag is not None and self._drag[1] == "end"
            self._drag = (T_part_grip, "end" if ended and phase != "start" else phase)

    def _follow(self) -> None:
        """Check the newest pose of a drag, and use the typed text after a pause."""
        while not self._closed:
            time.sleep(TICK)
            with self._lock:
                drag, self._drag = self._drag, None
                if self._typed and time.monotonic() - self._typed_at > REST:
                    self._take_typed()
                if drag is not None and self.point is not None:
                    self._moved(*drag)

    def _moved(self, T_part_grip: Array, phase: str) -> None:
        assert self.point is not None
        fields = fields_of(self._targets.snap(T_part_grip, self._panel.snapping, frame_of(self.point)))
        if phase == "end":
            if self._guarded(lambda: self.document.change(self.selected, fields)):
                self._panel.hint.content = HINTS["try"]
                self.show()
        else:
            self._panel.hint.content = HINTS["drag"]
            self._judged(self.point.model_copy(update=fields), with_handle=False)

    def _show_changes(self) -> None:
        self._panel.show_diff(self.document.diff(), self.document.changed)

    def _save(self, overwrite: bool) -> None:
        result = self.document.save(overwrite)
        if isinstance(result, Conflict):
            self._panel.conflict(result.diff)
            self._panel.say("Not saved: another program changed the file. Choose above which version to keep.")
            return
        self._told = False
        self._panel.conflict(None)
        self._panel.show_diff("", False)
        beside = f" The version of the other program is in {result.kept.name}." if result.kept else ""
        self._panel.say(f"Saved {self.document.path.name}.{beside}", GREEN)
        self._panel.hint.content = HINTS["saved"]

    def _reload(self) -> None:
        self._staying(self.document.reload)
        self._told = False
        self._panel.conflict(None)

    def _watch_file(self) -> None:
        """Detect changes of the file by other programs."""
        while not self._closed:
            time.sleep(POLL)
            with self._lock:
                try:
                    self._look_at_file()
                except PickproofError as error:  # it cannot be read at the moment
                    self._panel.say(str(error))

    def _look_at_file(self) -> None:
        if not self.document.changed_outside():
            if self.document.error:  # restored to the exact text that was read or saved last
                self.document.look_again()
                self._panel.say("The file can be read again.", GREEN)
                self.show()
            if self._told:
                self._told = False
                self._panel.conflict(None)
            return
        if self.document.error and self.document.changed and self.document.mended():
            self._panel.say("The file can be read again.", GREEN)
        if not self.document.changed:
            before = self.document.error
            self._staying(self.document.reload)  # there are no unsaved changes
            if self.document.error != before or not self.document.error:
                self._panel.say(
                    "" if self.document.error else "Another program changed the file; it was read again.", GREEN
                )
                self.show()
        elif not self.document.error and not self._told:
            self._told = True
            self._panel.conflict(self.document.their_diff())

    def try_it(self, choice: str) -> None:
        """Try the grasp in the physics, in one place or everywhere."""
        with self._lock:
            self._take_typed()
            if self.point is not None:
                self._tries.begin(self.point, choice)

    def film_of(self, choice: str) -> None:
        """Show the film of one place, from its start."""
        self._tries.film_of(choice)

    def film_at(self, seconds: float) -> None:
        """Show the film at a time."""
        self._tries.film_at(seconds)

    def play(self, on: bool) -> None:
        """Play or stop the film; from the start if it has ended."""
        self._tries.play(on)
