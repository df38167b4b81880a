from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pickproof.cell.frames import Array, about_axis, apply, make_transform, random_rotations
from pickproof.cell.geometry.bin import Bin
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.grasping.candidates import PER_ESTIMATE, PartEstimates, PickScene, Selection, select
from pickproof.grasping.clearance import OpenGripper, without_workpiece
from pickproof.grasping.grasp_points import MAX_TILT_DEG, GraspPoses, Turn, expand
from pickproof.grasping.overlap import LIES
from pickproof.grasping.ranking import GraspingConfig, robustness
from pickproof.grasping.verdict import VERDICTS, Verdict

NOTHING = np.zeros((0, 3))


class Chooser:
    """`select` for the bracket, with defaults for what a test does not care about."""

    def __init__(self, bracket: Workpiece, gripper: Gripper, poses: GraspPoses, source: Bin) -> None:
        self.bracket, self.gripper, self.poses, self.source = bracket, gripper, poses, source

    def __call__(self, Ts: Array, points: Array = NOTHING, **changes: Any) -> Selection:
        k = len(Ts)
        scores = changes.get("scores", np.full(k, 0.9))
        avoided = changes.get("avoided", np.zeros(k, dtype=bool))
        weights = GraspingConfig.model_validate(changes.get("weights", {}))
        poses = changes.get("poses", self.poses)
        where = changes.get("bin", self.source)
        estimates = PartEstimates(Ts, scores, avoided, changes.get("errors"))
        return select(estimates, poses, PickScene(self.bracket, self.gripper, where, points), weights)

    def lying(self, x: float = 0.0, y: float = 0.0, z: float = 0.008, yaw: float = 0.0) -> Array:
        """A bracket flat on its plate at a place of the bin."""
        return self.source.T_world_bin @ make_transform(t=(x, y, z)) @ about_axis((0, 0, 1), np.array(yaw))

    def surface(self, Ts: Array) -> Array:
        """The upper surface of workpieces as points, 2 mm apart or closer."""
        p, n = self.bracket.sample_surface(4000, seed=1)
        return np.concatenate([apply(T, p[(n @ T[:3, :3].T)[:, 2] > -0.1]) for T in Ts])


@pytest.fixture
def choose(bracket: Workpiece, gripper: Gripper, poses: GraspPoses, source: Bin) -> Chooser:
    return Chooser(bracket, gripper, poses, source)


def reasons(selection: Selection, estimate: int) -> dict[str, int]:
    """Poses of one estimate ruled out by each reason."""
    out: dict[str, int] = {}
    for of_point in selection.ruled_out[estimate].values():
        for reason, n in of_point.items():
            out[reason] = out.get(reason, 0) + n
    return out


def heap(choose: Chooser, n: int, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    t = rng.uniform([-0.11, -0.08, 0.01], [0.11, 0.08, 0.05], (n, 3))
    return choose.source.T_world_bin @ make_transform(random_rotations(n, rng), t)


@pytest.mark.slow
def test_no_verdict_is_cut(choose: Chooser) -> None:
    assert np.array(list(Verdict), dtype=VERDICTS).tolist() == [str(v) for v in Verdict]
    assert choose(choose.lying()[None]).verdicts[0].dtype == VERDICTS


def test_a_part_alone_in_the_middle_can_be_gripped(choose: Chooser) -> None:
    T = choose.lying()
    selection = choose(T[None], choose.surface(T[None]))
    assert len(selection.candidates) == PER_ESTIMATE
    assert "gripper_heap" not in reasons(selection, 0)


def test_a_part_pressed_by_points_all_around_cannot(choose: Chooser) -> None:
    T = choose.lying()
    around = np.stack(np.meshgrid(*[np.arange(-0.06, 0.06, 0.002)] * 2, np.arange(0, 0.05, 0.002)), -1).reshape(-1, 3)
    points = without_workpiece(apply(T, around), T, choose.bracket)
    selection = choose(T[None], points)
    assert not selection.candidates
    found = reasons(selection, 0)
    assert found["gripper_heap"] > 0
    assert set(found) <= {"tilt", "gripper_bin", "gripper_heap"}


def test_a_part_deep_under_the_floor_is_blocked_by_the_bin(choose: Chooser) -> None:
    selection = choose(choose.lying(z=-0.05)[None])
    assert not selection.candidates
    assert set(reasons(selection, 0)) == {"tilt", "gripper_bin"}


def test_every_pose_is_a_candidate_or_has_one_reason(choose: Chooser) -> None:
    Ts = heap(choose, 16, seed=3)
    for limit in (1000, 3):
        selection = choose(Ts, choose.surface(Ts), weights={"max_candidates": limit})
        assert sorted(selection.ruled_out) == list(range(len(Ts)))
        handed_on = np.bincount([c.estimate for c in selection.candidates], minlength=len(Ts))
        assert len(selection.candidates) <= limit
        assert handed_on.max() <= PER_ESTIMATE
        for k in range(len(Ts)):
            assert handed_on[k] + sum(reasons(selection, k).values()) == len(choose.poses.index)


def test_candidates_are_what_they_claim(choose: Chooser) -> None:
    """Upright, with room (checked one at a time), ranked by the weighted sum of terms, best first."""
    Ts = heap(choose, 12, seed=4)
    points = choose.surface(Ts)
    weights = GraspingConfig(weight_score=1.3, weight_priority=0.2)
    selection = choose(Ts, points, weights=weights.model_dump(), scores=np.linspace(0.5, 1.0, len(Ts)))
    assert len(selection.candidates) > 5
    ranks = [c.rank for c in selection.candidates]
    assert ranks == sorted(ranks, reverse=True)
    for c in selection.candidates:
        np.testing.assert_allclose(c.T_world_tool, Ts[c.estimate] @ c.T_part_tool, atol=1e-12)
        assert -c.T_world_tool[2, 2] >= np.cos(np.deg2rad(MAX_TILT_DEG))
        shape = OpenGripper.of(choose.gripper.boxes(c.opening))
        assert not shape.hits_bin(c.T_world_tool[None], choose.source).any()
        near = points[np.linalg.norm(points - Ts[c.estimate][:3, 3], axis=1) < 0.05]
        others = without_workpiece(near, Ts[c.estimate], choose.bracket)
        inside = shape.hits_points(c.T_world_tool[None], others, -0.003)
        assert not inside.any()  # all points, not the thinned ones, at a margin of about a voxel
        assert all(0 <= value <= 1 for value in c.terms.values())
        assert c.rank == pytest.approx(sum(getattr(weights, f"weight_{k}") * v for k, v in c.terms.items()))


def test_an_avoided_estimate_is_left_alone_with_that_reason(choose: Chooser) -> None:
    Ts = np.stack([choose.lying(-0.06), choose.lying(0.06)])
    selection = choose(Ts, avoided=np.array([True, False]))
    assert {c.estimate for c in selection.candidates} == {1}
    assert reasons(selection, 0) == {"avoided": len(choose.poses.index)}


def test_an_estimate_too_uncertain_for_a_grasp_is_ruled_out_by_tolerance(choose: Chooser) -> None:
    Ts = np.stack([choose.lying(-0.06), choose.lying(0.06)])
    tolerance = min(p.tolerance for p in choose.poses.points)
    selection = choose(Ts, errors=np.array([0.9 * tolerance, 1.0]))
    assert {c.estimate for c in selection.candidates} == {0}
    assert reasons(selection, 1) == {"tolerance": len(choose.poses.index)}


def test_an_estimate_with_too_low_a_score_is_ruled_out_by_score(choose: Chooser) -> None:
    Ts = np.stack([choose.lying(-0.06), choose.lying(0.06)])
    selection = choose(Ts, scores=np.array([0.49, 0.5]), weights={"min_score": 0.5})
    assert {c.estimate for c in selection.candidates} == {1}
    assert reasons(selection, 0) == {"score": len(choose.poses.index)}


def test_what_lies_under_a_known_workpiece_is_covered_and_free_when_that_one_is_doubtful(choose: Chooser) -> None:
    Ts = np.stack([choose.lying(), choose.lying(x=0.02, z=0.03)])
    strict = {"max_overlap_mm2": 0.0}
    under = choose(Ts, weights=strict)
    assert set(reasons(under, 0)) == {"covered"} and {c.estimate for c in under.candidates} == {1}
    assert {c.estimate for c in choose(Ts).candidates} == {0, 1}  # not asked for
    doubtful = choose(Ts, weights=strict, scores=np.array([0.9, 0.9 * LIES]))
    assert {c.estimate for c in doubtful.candidates} == {0, 1}


def test_switched_off_grasps_are_counted_as_disabled(choose: Chooser) -> None:
    points = tuple(p.model_copy(update={"enabled": p.name == "plate_from_top"}) for p in choose.poses.points)
    fewer = expand(points, choose.bracket)
    selection = choose(choose.lying()[None], poses=fewer)
    assert {c.point.name for c in selection.candidates} == {"plate_from_top"}
    of_point = selection.ruled_out[0]
    assert {name for name, counts in of_point.items() if set(counts) == {"disabled"}} == set(fewer.disabled)
    total = sum(reasons(selection, 0).values()) + len(selection.candidates)
    assert total == len(choose.poses.index)


def test_tilt_is_of_the_grasp_point_and_counts_from_its_own_direction(choose: Chooser) -> None:
    """A part flat on the floor: a side approach is tilted by 90 degrees, unless that is what the grasp point wants."""
    T = make_transform(t=(0, 0, 0.2)) @ choose.lying()
    side = next(p for p in choose.poses.points if p.name == "edge_of_plate").model_copy(update={"flip": False})
    free = choose.source
    direction = T[:3, :3] @ np.asarray(side.approach)
    for changes, verdicts in (
        ({}, {"tilt"}),
        ({"max_tilt_deg": 95.0}, set()),
        ({"world_approach": tuple(direction)}, set()),
        ({"world_approach": tuple(direction), "max_tilt_deg": 10.0}, {"tilt"}),
    ):
        poses = expand((side.model_copy(update=changes),), choose.bracket)
        selection = choose(T[None], poses=poses, bin=free)
        assert set(reasons(selection, 0)) - {"gripper_bin", "outranked"} == verdicts, changes
        for c in selection.candidates:
            limit = changes.get("max_tilt_deg", MAX_TILT_DEG)
            wanted = np.asarray(changes.get("world_approach", (0, 0, -1)))
            assert c.T_world_tool[:3, 2] @ wanted >= np.cos(np.deg2rad(limit)) - 1e-9


def test_the_same_input_gives_the_same_selection(choose: Chooser) -> None:
    Ts = heap(choose, 10, seed=5)
    a, b = (choose(Ts, choose.surface(Ts)) for _ in range(2))
    assert a.ruled_out == b.ruled_out
    assert [(c.estimate, c.point.name, c.rank) for c in a.candidates] == [
        (c.estimate, c.point.name, c.rank) for c in b.candidates
    ]
    for x, y in zip(a.candidates, b.candidates, strict=True):
        np.testing.assert_array_equal(x.T_world_tool, y.T_world_tool)


def test_turning_the_whole_cell_changes_no_decision(choose: Chooser, source: Bin) -> None:
    Ts = heap(choose, 8, seed=6)
    G = about_axis((0, 0, 1), np.array(1.1))
    turned = replace(source, position=tuple((G @ [*source.position, 1])[:3].tolist()), yaw=source.yaw + 1.1)
    a, b = choose(Ts), choose(G @ Ts, bin=turned)
    assert a.ruled_out == b.ruled_out
    assert len(a.candidates) > 5
    for x, y in zip(a.candidates, b.candidates, strict=True):
        assert (x.estimate, x.point) == (y.estimate, y.point)
        np.testing.assert_allclose(G @ x.T_world_tool, y.T_world_tool, atol=1e-12)


def test_no_estimates_and_no_poses(choose: Chooser, poses: GraspPoses) -> None:
    empty = choose(np.zeros((0, 4, 4)))
    assert (empty.candidates, empty.ruled_out) == ([], {})
    none = GraspPoses(poses.points, poses.index[:0], poses.Ts_part_tool[:0], *[np.zeros(0)] * 3)
    no_poses = choose(choose.lying()[None], poses=none)
    assert (no_poses.candidates, no_poses.ruled_out) == ([], {0: {}})


def test_the_highest_of_equals_comes_first(choose: Chooser) -> None:
    Ts = np.stack([choose.lying(-0.06, z=0.008), choose.lying(0.06, z=0.03)])
    assert choose(Ts).candidates[0].estimate == 1
    assert choose(Ts, weights={"weight_height": 0.0}, scores=np.array([0.9, 0.6])).candidates[0].estimate == 0


def test_another_part_between_the_fingers_or_close_beside_counts_against_a_grasp(choose: Chooser) -> None:
    """Points where the pads will close predict a double pick; points just outside the fingers leave little room."""
    T = choose.lying(z=0.02)
    plate = next(p for p in choose.poses.points if p.name == "plate_from_top").model_copy(
        update={"depths": (0.005,), "slide": None, "tool_rotation": Turn(), "flip": False}
    )
    poses = expand((plate,), choose.bracket)
    (tool,) = T @ poses.Ts_part_tool

    def terms(x: float, y: float, z: float) -> dict[str, float]:
        """Of the one grasp when a small cluster of points is at (x, y, z) of the tool frame."""
        grid = np.stack(np.meshgrid(*[[-0.003, 0.0, 0.003]] * 3), -1).reshape(-1, 3)
        (candidate,) = choose(T[None], apply(tool, grid + np.array([x, y, z])), poses=poses).candidates
        return candidate.terms

    above, beside, away = terms(0.0, 0.0, -0.030), terms(0.023, 0.0, -0.035), terms(0.05, 0.0, -0.01)
    assert (above["alone"], beside["alone"], away["alone"]) == (0.0, 1.0, 1.0)
    assert away["clearance"] == 1.0
    assert 0.0 < beside["clearance"] < 0.75


def test_robustness_falls_with_depth_slide_and_a_doubtful_pose(choose: Chooser) -> None:
    point = choose.poses.points[0].model_copy(update={"robustness": 0.8, "tolerance": 0.004})
    poses = expand((point,), choose.bracket)
    sure, doubtful = robustness(poses, 0.0), robustness(poses, 0.004)
    best = (poses.depth_rank == 0) & (poses.offset == 0)
    np.testing.assert_allclose(sure[best], 0.8)
    np.testing.assert_allclose(doubtful, 0.5 * sure)
    assert (sure[~best] < 0.8).all() and (sure >= 0).all()
