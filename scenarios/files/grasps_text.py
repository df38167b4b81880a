"""Writes the text of a whole grasps.yaml."""

from __future__ import annotations

from pickproof.cell.config import yaml_text
from pickproof.grasping.grasp_points import GraspPoint, GraspTable


def table_text(points: list[GraspPoint], gripper: str, comment: str = "") -> str:
    """The text of a grasps.yaml; fields that have their default are left out."""
    table = GraspTable(gripper=gripper, grasps=points).model_dump(mode="json", exclude_defaults=True)
    head = "".join(f"# {line}\n" for line in comment.splitlines())
    return head + yaml_text(table)
