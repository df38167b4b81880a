"""A grasps.yaml in the editor: changes with undo and redo, a diff, and saving that never overwrites changes of others.

The text is the document. Every change makes a new text that has passed the schema. So comments, order and number
formats are kept, and undo restores the exact text.
"""

from __future__ import annotations

import difflib
import fcntl
import hashlib
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pickproof.cell.config import parse_yaml
from pickproof.cell.errors import InputError
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.grasping.grasp_points import GraspPoint, GraspTable, check_openings, parse_table
from pickproof.scenarios.files.atomic import write_whole
from pickproof.scenarios.files.grasps_yaml import entry_text, rearrange, set_fields
from pickproof.scenarios.files.yaml_edit import EditError, check_text


@dataclass(frozen=True)
class Saved:
    """The file holds the document now. `kept` is the backup of another program's version, None for none."""

    kept: Path | None = None


@dataclass(frozen=True)
class Conflict:
    """The file was changed by another program since it was read; nothing was written. `diff` shows that change."""

    diff: str


@dataclass(frozen=True)
class _State:
    text: str
    table: GraspTable


class GraspDocument:
    """The grasp points of one workpiece, as text and as a table that has passed the schema.

    Attributes:
        path: of the file. A new file starts with one grasp through the centre of mass.
        error: why the file on disk cannot be edited, else empty. With an error nothing is written.
    """

    def __init__(self, path: Path, workpiece: Workpiece, gripper: Gripper) -> None:
        self.path, self._workpiece, self._gripper = path, workpiece, gripper
        self.error = ""
        self._past: list[_State] = []
        self._future: list[_State] = []
        self._state: _State | None = None
        self._base = ""  # the text that the file had when it was read or written last
        self._seen: str | None = None  # the hash of the file then, None for no file
        self.reload()

    @property
    def text(self) -> str:
        """The text to be saved."""
        return self._state.text if self._state else ""

    @property
    def points(self) -> tuple[GraspPoint, ...]:
        """Of the text; none while the file cannot be read."""
        return tuple(self._state.table.grasps) if self._state else ()

    @property
    def gripper(self) -> str:
        """Name of the gripper that the table is for."""
        return self._state.table.gripper if self._state else self._gripper.name

    @property
    def changed(self) -> bool:
        """Whether there is something to save."""
        return self._state is not None and (self.text != self._base or self._seen is None)

    @property
    def can_undo(self) -> bool:
        """Whether there is a change to undo."""
        return bool(self._past)

    @property
    def can_redo(self) -> bool:
        """Whether there is an undone change to make again."""
        return bool(self._future)

    def change(self, index: int, fields: Mapping[str, Any]) -> None:
        """Set fields of a grasp; None removes a field from the file, so that it has its default.

        Fields that already have the value are not changed, in whatever form they are written.

        Raises:
            InputError: the table would not fit the schema or the gripper; nothing is changed.
        """
        point = self.points[index]
        new = {k: v for k, v in fields.items() if v is None or not _same(getattr(point, k), v)}
        written = self._written(index)
        new = {k: v for k, v in new.items() if v is not None or k in written}
        if new:
            self._become(lambda text: set_fields(text, index, {k: _plain(v) for k, v in new.items()}))

    def add(self, point: GraspPoint, after: int | None = None) -> int:
        """Insert a new grasp after the one at `after`, or at the end; returns its index."""
        n = len(self.points)
        at = n if after is None else after + 1
        self._become(lambda text: rearrange(text, [*range(at), point, *range(at, n)]))
        return at

    def remove(self, index: int) -> None:
        """Remove a grasp, with the comments directly above and beside it."""
        if len(self.points) == 1:
            raise InputError(self.path, "grasps", "the last grasp", "at least one; disable it instead")
        self._become(lambda text: rearrange(text, [i for i in range(len(self.points)) if i != index]))

    def move(self, index: int, to: int) -> None:
        """Move a grasp to another position of the list, with its comments."""
        order = [i for i in range(len(self.points)) if i != index]
        order.insert(int(np.clip(to, 0, len(order))), index)
        self._become(lambda text: rearrange(text, order))

    def free_name(self, wanted: str) -> str:
        """`wanted`, or the first of wanted_2, wanted_3, ... that no grasp has."""
        taken, name, n = {p.name for p in self.points}, wanted, 1
        while name in taken:
            n += 1
            name = f"{wanted}_{n}"
        return name

    def undo(self) -> None:
        """Undo one change, including a reload."""
        if self._past and self._state:
            self._future.append(self._state)
            self._state = self._past.pop()

    def redo(self) -> None:
        """Redo the last undone change."""
        if self._future and self._state:
            self._past.append(self._state)
            self._state = self._future.pop()

    def diff(self) -> str:
        """The changes that saving would write, as a unified diff; empty for none."""
        return _diff(self._base if self._seen is not None else "", self.text, self.path.name)

    def changed_outside(self) -> bool:
        """Whether the file on disk differs from what was read or saved last."""
        return _hash(self.path) != self._seen

    def their_diff(self) -> str:
        """The changes of another program since the file was read or saved last, as a unified diff."""
        theirs = self._disk()
        return _diff(self._base, theirs.decode("utf-8", "replace"), self.path.name)

    def reload(self) -> None:
        """Load the file from disk; `undo` restores the edited text. `error` is set if it cannot be read."""
        try:
            data = self._disk() if self.path.exists() else None
            text = self._begun() if data is None else data.decode("utf-8")
            state = self._checked(text)
            check_text(text)
        except EditError as error:
            self.error = f"{self.path}: {error}"
            return
        except (InputError, OSError, UnicodeDecodeError) as error:
            self.error = str(error)
            return
        if self._state is not None and self.text != state.text:
            self._past.append(self._state)
            self._future.clear()
        self.error, self._state = "", state
        self._base, self._seen = text, None if data is None else hashlib.sha256(data).hexdigest()

    def look_again(self) -> None:
        """The file is again as it was read or saved last: clear the error and keep the edited text."""
        if self._state is None:
            self.reload()
        else:
            self.error = ""

    def mended(self) -> bool:
        """Whether a changed file on disk can be read; it is not loaded."""
        try:
            self._checked(self._disk().decode("utf-8"))
        except (InputError, UnicodeDecodeError):
            return False
        self.error = ""
        return True

    def save(self, overwrite: bool = False) -> Saved | Conflict:
        """Write the text atomically, unless another program changed the file.

        With `overwrite` it is written anyway, and the other version is kept beside it as NAME.theirs-N.

        Raises:
            InputError: there is nothing to save, or the file on disk is invalid: it is never overwritten.
            StoreError: it cannot be written.
        """
        if self._state is None:
            raise InputError(self.path, "", self.error, "a file that can be read")
        target, kept = self.path.resolve(), None
        target.parent.mkdir(parents=True, exist_ok=True)
        with _locked(target.parent):
            if self.changed_outside():
                if not overwrite:
                    return Conflict(self.their_diff())
                theirs = self._disk()
                if theirs:
                    self._checked(theirs.decode("utf-8", "replace"))
                    kept = _free(target)
                    kept.write_bytes(theirs)
            mode = target.stat().st_mode if target.exists() else None
            write_whole(target, self.text)
            if mode is not None:
                target.chmod(mode)
            self._base, self._seen, self.error = self.text, _hash(target), ""
        return Saved(kept)

    def _disk(self) -> bytes:
        """The text on disk, empty for no file.

        Raises:
            InputError: it cannot be read.
        """
        try:
            return self.path.read_bytes()
        except FileNotFoundError:
            return b""
        except OSError as error:
            raise InputError(self.path, "", str(error.strerror), "a file that can be read") from None

    def _become(self, change: Any) -> None:
        if self._state is None:
            raise InputError(self.path, "", self.error, "a file that can be read")
        try:
            state = self._checked(change(self.text))
        except EditError as error:
            raise InputError(self.path, "", str(error), "a file that can be changed by a program") from None
        if state.text != self.text:
            self._past.append(self._state)
            self._future.clear()
            self._state = state

    def _checked(self, text: str) -> _State:
        table = parse_table(parse_yaml(text, self.path), self.path)
        points = [g if g.gripper else g.model_copy(update={"gripper": table.gripper}) for g in table.grasps]
        check_openings(points, self._gripper, self.path)
        return _State(text, table)

    def _written(self, index: int) -> set[str]:
        """Fields of a grasp that are in the file."""
        return set(parse_yaml(self.text, self.path)["grasps"][index])

    def _begun(self) -> str:
        head = (
            f"# Grasp points of {self._workpiece.name}; the schema is in docs/reference/grasps-file.md.\n"
            "# [m] and unit vectors in the CAD frame.\n"
        )
        return (
            f"{head}gripper: {self._gripper.name}\ngrasps:\n{entry_text(begun_point(self._workpiece, self._gripper))}"
        )


def begun_point(workpiece: Workpiece, gripper: Gripper, name: str = "new") -> GraspPoint:
    """The first grasp of a new file: from above through the centre of mass, across the narrower horizontal side."""
    side = int(np.argmin(workpiece.extents[:2]))
    widest = gripper.max_opening - 0.005 if gripper.max_opening else 0.02
    return GraspPoint(
        name=name,
        centre=tuple(round(float(x), 6) + 0.0 for x in workpiece.com),
        approach=(0.0, 0.0, -1.0),
        closing=(1.0, 0.0, 0.0) if side == 0 else (0.0, 1.0, 0.0),
        width=round(float(np.clip(workpiece.extents[side], 1e-3, widest)), 5),
    )


def _same(a: Any, b: Any) -> bool:
    a, b = _plain(a), _plain(b)
    if isinstance(a, float) and isinstance(b, (int, float)) and not isinstance(b, bool):
        return abs(a - b) < 1e-9
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(_same(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(_same(a[k], b[k]) for k in a)
    return bool(a == b)


def _plain(value: Any) -> Any:
    """As YAML knows it."""
    if hasattr(value, "model_dump"):
        return value.model_dump(mode="json")
    if isinstance(value, (tuple, list)):
        return [_plain(v) for v in value]
    return value


def _diff(a: str, b: str, name: str) -> str:
    return "\n".join(difflib.unified_diff(a.splitlines(), b.splitlines(), name, f"{name} (changed)", lineterm=""))


def _hash(path: Path) -> str | None:
    """Of what is on disk; None for no file, empty for what cannot be read."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except FileNotFoundError:
        return None
    except OSError:
        return ""


def _free(path: Path) -> Path:
    n = 1
    while (kept := path.with_name(f"{path.name}.theirs-{n}")).exists():
        n += 1
    return kept


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """A lock against other editors in this folder; the system releases it when the process ends."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)
