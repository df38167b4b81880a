"""The widgets of the grasp editor, and the action of the editor that each one calls."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from pickproof.grasping.grasp_points import GraspPoint
from pickproof.scenarios.grasp_editor.fields import FieldWidgets
from pickproof.scenarios.grasp_editor.film import Outcome
from pickproof.scenarios.grasp_editor.geometry_checks import GraspJudge, GraspVerdict
from pickproof.scenarios.grasp_editor.snapping import Plane, Snapping

RED, GREEN, AMBER = "#c62f2f", "#1f8a4c", "#b36b00"
SLIPS = 2e-3  # [m] slip from which a grasp that held gets a warning
CAD = "as in the CAD"
EVERYWHERE, HEAP = "everywhere", "in a heap"
HINTS = {
    "choose": "**1. Choose** a grasp in the list or click its ball. Then drag the arrows and rings at it.",
    "drag": "**2. Check the verdict** below while you drag. Green is good. *Fit* moves the pads to the part's faces.",
    "try": "**3. Try it** in the physics (tab *Try*), free on a table and in a heap.",
    "lost": "**It held nowhere.** The table gives the reasons. Drag the grasp or change its fields, and try again.",
    "tried": "**4. Save** (tab *Save*): you see what changes in the file before it is written.",
    "saved": "**Saved.** `pickproof run` uses it from now on. Choose the next grasp, or close the page.",
}


class Actions(Protocol):
    """The actions of the editor; each is safe to call from any thread."""

    def select(self, index: int) -> None:
        """Edit another grasp."""

    def change(self, name: str, value: Any) -> None:
        """Give a field of the grasp another value."""

    def refuse(self, line: str) -> None:
        """Show why something cannot be done."""

    def act(self, name: str) -> None:
        """Press a button, named by its label in lower case."""

    def mirror(self, plane: Plane) -> None:
        """Add the grasp as it is on the other side of a plane."""

    def view(self, name: str, on: bool) -> None:
        """Show or hide something of the scene."""

    def lie(self, choice: str) -> None:
        """Turn the workpiece to a way of lying."""

    def try_it(self, choice: str) -> None:
        """Try the grasp in the physics, in one place or everywhere."""

    def play(self, on: bool) -> None:
        """Run the film, or stop it."""

    def film_of(self, choice: str) -> None:
        """Show the film of one place."""

    def film_at(self, seconds: float) -> None:
        """Show the film at a time [s]."""


class Panel:
    """Builds the panel on a viser server and writes into it."""

    def __init__(self, gui: Any, title: str, planes: Sequence[Plane], actions: Actions) -> None:
        self._gui, self._actions = gui, actions
        self._planes = {plane.name: plane for plane in planes}
        gui.add_markdown(f"#### {title}")
        self.hint = gui.add_markdown(HINTS["choose"])
        self._banner = gui.add_markdown("", visible=False)
        with gui.add_folder("The file was changed by another program", visible=False) as self._conflict:
            self._theirs = gui.add_markdown("")
            self._button("Reload it (Undo restores your version)", "reload")
            self._button("Overwrite it (the other version is kept beside it)", "overwrite")
        self._list = gui.add_dropdown("grasp", ("-",))
        self._list.on_update(self._chosen)
        undo = gui.add_button_group("", ("Undo", "Redo", "Fit"))
        undo.on_click(lambda event: actions.act(event.target.value.lower()))
        self._verdict = gui.add_markdown("")
        tabs = gui.add_tab_group()
        with tabs.add_tab("Grasp"):
            self._grasp_tab()
        with tabs.add_tab("Fields"):
            self.fields = FieldWidgets(gui, actions.change, actions.refuse)
        with tabs.add_tab("Try"):
            self._try_tab()
        with tabs.add_tab("Save"):
            gui.add_markdown("Changes that saving writes to the file. Comments and order are kept.")
            self._button("Show changes", "show changes")
            self._write = self._button("Write the file", "save")
            self._write.visible = False
            self._diff = gui.add_markdown("")

    def _grasp_tab(self) -> None:
        gui, actions = self._gui, self._actions
        for names in (("Add", "Duplicate", "Delete"), ("Up", "Down", "On / off")):
            group = gui.add_button_group("", names)
            group.on_click(lambda event: actions.act(event.target.value.lower()))
        plane = gui.add_dropdown("mirror at", tuple(self._planes))
        mirror = gui.add_button("Mirror", hint="a copy of the grasp on the other side of that plane")
        mirror.on_click(lambda _: actions.mirror(self._planes[plane.value]))
        with gui.add_folder("Snap to, while dragging"):
            self._snaps = {
                name: gui.add_checkbox(label, getattr(Snapping(), name))
                for name, label in (
                    ("normals", "surface normals"),
                    ("edges", "edges"),
                    ("centre_planes", "centre planes"),
                    ("symmetry_planes", "symmetry planes"),
                )
            }
        with gui.add_folder("Show"):
            self._lies = gui.add_dropdown("workpiece lies", (CAD,), hint="resting poses, likeliest first")
            self._lies.on_update(lambda event: actions.lie(event.target.value))
            for name, label, on in (
                ("others", "other grasps", True),
                ("bodies", "whole grippers of all grasps", False),
                ("ghosts", "symmetric copies", True),
                ("symmetry", "symmetry axes and centre of mass", True),
                ("planes", "planes of symmetry", False),
            ):
                box = gui.add_checkbox(label, on)
                box.on_update(lambda event, name=name: actions.view(name, event.target.value))

    def _try_tab(self) -> None:
        gui, actions = self._gui, self._actions
        self._where = gui.add_dropdown("where", (EVERYWHERE, HEAP))
        self._try = gui.add_button("Try this grasp", hint="grip, lift and shake in the physics", disabled=True)
        self._try.on_click(lambda _: actions.try_it(self._where.value))
        self._button("Another heap", "another heap")
        self._results = gui.add_markdown("Grips, lifts and shakes the part; a heap trial runs as in a campaign.")
        with gui.add_folder("Film", visible=False) as self._film:
            which = gui.add_dropdown("film", ("-",))
            which.on_update(self._film_chosen)
            self._which = which
            self.time = gui.add_slider("time [s]", 0.0, 1.0, 0.02, 0.0)
            self.time.on_update(lambda _: actions.film_at(float(self.time.value)))
            play = gui.add_button_group("", ("Play", "Stop", "Back to editing"))
            play.on_click(self._played)

    def _film_chosen(self, event: Any) -> None:
        if event.client is not None:
            self._actions.film_of(event.target.value)

    def _played(self, event: Any) -> None:
        if event.target.value == "Back to editing":
            self._actions.act("back to editing")
        else:
            self._actions.play(event.target.value == "Play")

    def _button(self, label: str, action: str) -> Any:
        button = self._gui.add_button(label)
        button.on_click(lambda _: self._actions.act(action))
        return button

    def _chosen(self, event: Any) -> None:
        if event.client is not None and event.target.value in self._list.options:
            self._actions.select(self._list.options.index(event.target.value))

    @property
    def snapping(self) -> Snapping:
        """The ticked options."""
        return Snapping(**{name: box.value for name, box in self._snaps.items()})

    def list_grasps(self, points: Sequence[GraspPoint], selected: int) -> None:
        """The names; those that are off are marked."""
        options = tuple(f"{p.name}{'' if p.enabled else ' (off)'}" for p in points) or ("-",)
        if self._list.options != options:
            self._list.options = options
        self._list.value = options[min(selected, len(options) - 1)]

    def list_resting(self, n: int) -> None:
        """Set the number of resting poses; the physics is ready then."""
        poses = tuple(resting_name(k) for k in range(n))
        self._lies.options = (CAD, *poses)
        self._where.options = (EVERYWHERE, *poses, HEAP)
        self._try.disabled = False

    def say(self, line: str, colour: str = RED) -> None:
        """Show one line above the page, empty for none."""
        self._banner.content = f'<span style="color:{colour}">**{_escaped(line)}**</span>' if line else ""
        self._banner.visible = bool(line)

    def conflict(self, diff: str | None) -> None:
        """Ask which of two versions to keep; None when that is decided."""
        self._conflict.visible = diff is not None
        self._theirs.content = f"Changed there:\n```diff\n{diff}\n```" if diff else ""

    def show_diff(self, diff: str, changed: bool) -> None:
        """Show the changes of saving, and the save button."""
        self._diff.content = f"```diff\n{diff}\n```" if diff else "No changes: the file is up to date."
        self._write.visible = changed

    def forget_diff(self) -> None:
        """The text has changed since it was shown."""
        self._diff.content, self._write.visible = "", False

    def busy(self, on: bool) -> None:
        """Show that a trial is running."""
        self._try.disabled = on
        if on:
            self._results.content = "Trying ..."

    def results(self, outcomes: dict[str, Outcome], seconds: float) -> None:
        """Show the result of a trial in each place."""
        rows = [f"| {name} | {_said(outcome)} |" for name, outcome in outcomes.items()]
        table = ["| where | result |", "|---|---|", *rows]
        self._results.content = "\n".join([*table, "", f"took {seconds:.1f} s"])
        films = tuple(name for name, outcome in outcomes.items() if outcome.film is not None)
        self._film.visible = bool(films)
        if films:
            self._which.options = films
            self._which.value = films[0]

    def verdict(
        self, judge: GraspJudge, verdict: GraspVerdict, point: GraspPoint, free: tuple[int, int] | None
    ) -> None:
        """The geometry of the grasp as it stands."""
        doubts = judge.doubts(verdict, point)
        colour = RED if doubts else GREEN
        lines = [f'<span style="color:{colour}">**{"; ".join(doubts) or "geometry is fine"}**</span>']
        if verdict.use is None:
            left, right = (f"{1e6 * a:.0f}" for a in verdict.areas)
            angle = max(verdict.angles) * 57.29578
            lines += [
                f"width between pads {1e3 * verdict.width:.2f} mm; face under pads {left} and {right} mm²",
                f"angle to the surface {angle:.1f}° (holds below {judge.cone * 57.29578:.0f}°); closing pushes "
                f"{1e3 * abs(verdict.off_centre):.2f} mm",
            ]
        else:
            lines.append(f"uses {100 * verdict.use:.0f} % of the load limits of the faces at 12 m/s²")
        lines.append(f"centre of mass {1e3 * verdict.com_offset:.1f} mm beside the grip")
        if free is not None:
            lines.append(f"{free[0]} of its {free[1]} poses are free of collisions with the part")
        self._verdict.content = "  \n".join(lines)


def resting_name(k: int) -> str:
    """Of the resting pose that is the k-th likeliest."""
    return f"resting pose {k}"


def _said(outcome: Outcome) -> str:
    if not outcome.held:
        return f'<span style="color:{RED}">{outcome.reason.replace("_", " ")}</span>'
    colour = AMBER if outcome.slip > SLIPS else GREEN
    return f'<span style="color:{colour}">holds, slips {1e3 * outcome.slip:.2f} mm</span>'


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace("*", "\\*").replace("_", "\\_")
