from __future__ import annotations

from tests.benchmarks.collision_agreement import compare


def test_planner_and_physics_see_the_same_contacts() -> None:
    """100,000 configurations take a minute: `python -m tests.benchmarks.collision_agreement`."""
    found = compare(2000, seed=1)
    assert found["far"] == 0, found["far_at"]
    assert found["near"] <= 20
    assert min(found["free"], found["touching"]) > 300
