"""The fields of a grasp point as widgets: [mm] and [deg] on the page, [m] and [deg] in the file."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

from pickproof.cell.errors import InputError
from pickproof.grasping.grasp_points import GraspPoint, Turn

Kind = str
FIELDS: tuple[tuple[str, Kind, str], ...] = (
    ("name", "text", "name"),
    ("enabled", "switch", "enabled"),
    ("gripper", "text_or_none", "gripper (empty: the table's)"),
    ("centre", "point_mm", "centre [mm]"),
    ("approach", "direction", "approach"),
    ("closing", "direction", "closing"),
    ("width", "mm", "width [mm]"),
    ("opening", "mm_or_none", "opening [mm] (empty: width + 5)"),
    ("stroke", "mm_or_none", "stroke [mm] (in place of opening)"),
    ("depths", "mm_list", "depths [mm]"),
    ("approach_distance", "mm", "approach distance [mm]"),
    ("retract_distance", "mm", "retract distance [mm]"),
    ("priority", "share", "priority"),
    ("tolerance", "mm", "tolerance [mm]"),
    ("robustness", "share", "robustness"),
    ("symmetry", "switch", "symmetry"),
    ("flip", "switch", "flip"),
    ("world_approach", "direction", "world approach"),
    ("max_tilt_deg", "degrees", "max tilt [deg]"),
    ("tool_rotation", "turn", "tool rotation [deg]: from, to, step"),
    ("approach_rotation", "turn", "approach rotation [deg]: from, to, step"),
    ("part_rotation", "turn", "part rotation [deg]: from, to, step"),
    ("part_axis", "direction", "part axis"),
    ("slide", "slide", "slide along x y z: by [mm] (empty: none)"),
)
"""Name in the schema, kind of widget, label; in the order of the page."""
HINTS = {
    "name": "unique in the file; records and reports show it",
    "centre": "point between the pads, in the CAD frame",
    "approach": "direction of approach, in the CAD frame",
    "closing": "direction in which the jaws close; kept perpendicular to the approach",
    "priority": "0 to 1, a term of the rank",
    "slide": "freedom to shift the grasp, as 1 0 0: 0, 8, -8",
}


class FieldWidgets:
    """One widget for each field of a grasp point in the container that is open.

    Args:
        changed: called with the field's name and its new value as the schema has it, whenever a user changes one.
        refused: called with one line when what a user typed cannot be read.
    """

    def __init__(self, gui: Any, changed: Callable[[str, Any], None], refused: Callable[[str], None]) -> None:
        self._handles: dict[str, Any] = {}
        for name, kind, label in FIELDS:
            hint = HINTS.get(name) or GraspPoint.model_fields[name].description
            handle = _add(gui, kind, label, hint)
            self._handles[name] = handle
            handle.on_update(_listener(name, kind, handle, changed, refused))

    def show(self, point: GraspPoint, leave: Mapping[str, Any] | None = None) -> None:
        """Show the values of a grasp point in the widgets, except those that a user is editing."""
        for name, kind, _ in FIELDS:
            if name not in (leave or {}):
                self._handles[name].value = to_widget(kind, getattr(point, name))

    def enable(self, on: bool) -> None:
        """Enable or disable the widgets."""
        for handle in self._handles.values():
            handle.disabled = not on


def to_widget(kind: Kind, value: Any) -> Any:
    """A value of the schema in the form of its widget."""
    if kind == "mm":
        return round(1e3 * value, 4)
    if kind == "point_mm":
        return tuple(round(1e3 * v, 4) for v in value)
    if kind == "mm_or_none":
        return "" if value is None else f"{1e3 * value:.6g}"
    if kind == "mm_list":
        return ", ".join(f"{1e3 * v:.6g}" for v in value)
    if kind == "turn":
        return (value.from_deg, value.to_deg, value.step_deg)
    if kind == "text_or_none":
        return value or ""
    if kind == "slide":
        if value is None:
            return ""
        along, by = " ".join(f"{v:.6g}" for v in value.along), ", ".join(f"{1e3 * v:.6g}" for v in value.offsets)
        return f"{along}: {by}"
    return value


def from_widget(kind: Kind, name: str, value: Any) -> Any:
    """The content of a widget as a value of the schema; None means the default.

    Raises:
        InputError: numbers that cannot be read.
    """
    if kind == "mm":
        return round(float(value) / 1e3, 9)
    if kind == "point_mm":
        return [round(v / 1e3, 9) for v in value]
    if kind == "mm_or_none":
        return round(_numbers(name, value, 1)[0] / 1e3, 9) if str(value).strip() else None
    if kind == "mm_list":
        return [round(v / 1e3, 9) for v in _numbers(name, value)]
    if kind == "turn":
        turn = dict(zip(("from_deg", "to_deg", "step_deg"), map(float, value), strict=True))
        return None if turn == Turn().model_dump() else turn
    if kind == "text_or_none":
        return str(value).strip() or None
    if kind == "text":
        return str(value).strip()
    if kind == "slide":
        if not str(value).strip():
            return None
        along, colon, by = str(value).partition(":")
        if not colon:
            raise InputError("page", name, value, "a direction, a colon, offsets, as 1 0 0: 0, 8, -8")
        return {"along": _numbers(name, along, 3), "offsets": [round(v / 1e3, 9) for v in _numbers(name, by)]}
    return list(value) if isinstance(value, tuple) else value


def _numbers(name: str, text: str, count: int | None = None) -> list[float]:
    words = [word for word in re.split(r"[\s,;]+", str(text)) if word]
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if not numbers or (count is not None and len(numbers) != count):
        raise InputError("page", name, text, "numbers, as 4, 1.5" if count is None else f"{count} numbers")
    return numbers


def _add(gui: Any, kind: Kind, label: str, hint: str | None) -> Any:
    if kind == "switch":
        return gui.add_checkbox(label, True, hint=hint)
    if kind == "share":
        return gui.add_slider(label, 0.0, 1.0, 0.01, 1.0, hint=hint)
    if kind in ("mm", "degrees"):
        return gui.add_number(label, 1.0, min=0.0, step=0.1 if kind == "mm" else 1.0, hint=hint)
    if kind in ("point_mm", "direction", "turn"):
        return gui.add_vector3(
            label, (0.0, 0.0, 0.0), step={"point_mm": 0.1, "direction": 0.001, "turn": 1.0}[kind], hint=hint
        )
    return gui.add_text(label, "", hint=hint)


def _listener(
    name: str, kind: Kind, handle: Any, changed: Callable[[str, Any], None], refused: Callable[[str], None]
) -> Callable[[Any], None]:
    def listen(event: Any) -> None:
        if event.client is None:
            return  # written by the page itself
        try:
            value = from_widget(kind, name, handle.value)
        except InputError as error:
            refused(str(error))
            return
        changed(name, value)

    return listen
