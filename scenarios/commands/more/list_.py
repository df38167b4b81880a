"""`pickproof list`: scenarios and workpieces."""

from __future__ import annotations


def list_() -> int:
    """Print the names that other commands take."""
    from pickproof.cell.workpiece.workpiece import list_workpieces
    from pickproof.scenarios.config.scenario import list_scenarios, load_scenario

    print("scenarios")
    for name in list_scenarios():
        scenario = load_scenario(name)
        print(f"  {name:20} {scenario.count} x {scenario.workpiece}, {scenario.robot} with {scenario.gripper}")
    print("workpieces")
    for name in list_workpieces():
        print(f"  {name}")
    return 0
