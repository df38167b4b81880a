"""The text of a whole grasps.yaml."""

from __future__ import annotations

import yaml

from pickproof.grasping.grasp_points import GraspPoint, GraspTable


def table_text(points: list[GraspPoint], gripper: str, comment: str = "") -> str:
    """The text of a grasps.yaml; fields that have their default are left out."""
    table = GraspTable(gripper=gripper, grasps=points).model_dump(mode="json", exclude_defaults=True)
    head = "".join(f"# {line}\n" for line in comment.splitlines())
    return head + str(yaml.safe_dump(table, sort_keys=False, default_flow_style=None, width=120))
