"""Why a mesh cannot become a workpiece."""

from __future__ import annotations


class MeshError(Exception):
    """What was found, and what would have been accepted; it becomes an InputError where the file's name is known."""

    def __init__(self, found: str, valid: str) -> None:
        super().__init__(found, valid)
        self.found, self.valid = found, valid
