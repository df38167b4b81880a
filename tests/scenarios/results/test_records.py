import numpy as np
import pytest

from pickproof.scenarios.results.records import NO_PICK_REASONS, AttemptRecord, Reason


def record(**changes):
    fields = {"seed": 1, "attempt": 0, "moved": True, "success": True, "reason": "", "parts_in_bin_before": 5}
    return AttemptRecord(**{**fields, "n_estimates": 2, **changes})


def test_success_and_reason_exclude_each_other():
    with pytest.raises(ValueError, match="success True"):
        record(reason="missed")
    with pytest.raises(ValueError, match="success False"):
        record(success=False)
    with pytest.raises(ValueError, match="bad_luck"):
        record(success=False, reason="bad_luck")


@pytest.mark.parametrize("reason", list(Reason))
def test_only_no_picks_do_not_move(reason):
    moved = reason not in NO_PICK_REASONS
    assert record(success=False, moved=moved, reason=str(reason)).reason is reason
    with pytest.raises(ValueError, match="moved"):
        record(success=False, moved=not moved, reason=reason)


def test_numpy_values_become_plain():
    a = record(seed=np.int64(3), moved=np.bool_(True), error_mm=np.float32(0.5), part_poses_after=np.ones((2, 7)))
    assert type(a.seed) is int and type(a.moved) is bool and type(a.error_mm) is float
    assert a.part_poses_after == ((1.0,) * 7,) * 2
    assert a == record(seed=3, error_mm=0.5, part_poses_after=((1.0,) * 7,) * 2)


def test_cycle_is_the_sum_of_its_parts():
    a = record(sensing_s=0.4, perceive_s=0.5, choose_s=0.1, plan_s=0.2, robot_s=2.0)
    assert a.compute_s == pytest.approx(0.8)
    assert a.cycle_s == pytest.approx(3.2)
