"""What each stage costs: sums, names, and a planted loss through the real campaigns."""

import json
from io import StringIO

import numpy as np
import pytest
from rich.console import Console

from pickproof.cell.errors import InputError
from pickproof.scenarios.commands.cli import main
from pickproof.scenarios.comparison.attribution import MODES, attribute, print_attribution, verdict_line
from pickproof.scenarios.comparison.attribution_run import folder_of, run_modes
from pickproof.scenarios.comparison.paired import Outcome
from pickproof.scenarios.config.scenario import load_scenario
from pickproof.scenarios.results.store import FILE
from pickproof.scenarios.statistics.intervals import wilson
from tests.scenarios import planted_oracles

FILES = [f"{k}.sqlite" for k in range(4)]


def side(rates, attempts=20, seeds=range(12)):
    """Episodes with these pooled rates, the same in every seed but for one pick."""
    good = [round(rates * attempts) - (s % 2 if rates < 1 else 0) for s in seeds]
    return [Outcome(s, attempts, g, attempts, g, True) for s, g in zip(seeds, good, strict=True)]


def summary(outcomes):
    n, good = sum(o.attempts for o in outcomes), sum(o.successes for o in outcomes)
    rate = good / n if n else None
    bounds = wilson(good, n) if n else (0.0, 1.0)
    base = {"scenario": "x", "success_rate": rate, "clearance": 1.0, "no_picks": 0, "attempts": n, "successes": good}
    return base | {"cluster95": bounds, "reasons": {"slipped": n - good} if n > good else {}}


def attributed(*rates, **kwargs):
    sides = [side(r, **kwargs) for r in rates]
    return attribute(sides, [summary(s) for s in sides], FILES)


def test_modes_replace_one_stage_more_each():
    assert [folder_of(m) for m in MODES] == [
        "nothing", "perception", "perception+grasp", "perception+grasp+motion",
    ]  # fmt: skip


def test_costs_add_up_to_what_all_oracles_gain():
    a = attributed(0.6, 0.75, 0.95, 1.0)
    gains = [s.success.difference for s in a.stages]
    first, last = a.summaries[0]["success_rate"], a.summaries[-1]["success_rate"]
    assert sum(gains) == pytest.approx(last - first)
    assert a.rest == pytest.approx(1 - last)
    assert sum(s.most for s in a.stages) == pytest.approx(1.0)
    for s in a.stages:
        assert s.success.interval95[0] <= s.success.difference <= s.success.interval95[1]
        assert s.bootstrap95[0] - 1e-12 <= s.success.difference <= s.bootstrap95[1] + 1e-12


@pytest.mark.parametrize(
    ("rates", "named"),
    [((0.5, 0.9, 0.95, 0.95), "perception"), ((0.6, 0.65, 0.95, 1.0), "grasp"), ((0.7, 0.7, 0.7, 1.0), "motion")],
)
def test_the_costliest_stage_is_named(rates, named):
    a = attributed(*rates)
    assert (a.named, a.basis) == (named, "success")
    assert f"mend {named} first" in verdict_line(a)


def test_the_table_fits_a_terminal_of_80_columns():
    console = Console(width=80, record=True, file=StringIO())
    print_attribution(console, attributed(0.5, 0.9, 0.95, 0.95))
    shown = console.export_text()
    assert "…" not in shown and "+ perception" in shown and "no-picks" in shown


def test_where_nothing_differs_nothing_is_named():
    a = attributed(1.0, 1.0, 1.0, 1.0)
    assert a.named is None and verdict_line(a).startswith("no evidence")
    assert attributed(0.9, 0.9, 0.9, 0.9).named is None


def test_what_no_oracle_mends_leads_where_it_is_more_than_any_stage():
    a = attributed(0.3, 0.35, 0.4, 0.4)
    assert verdict_line(a).startswith("mend the grip first") and "slipped" in verdict_line(a)
    assert verdict_line(attributed(0.6, 0.65, 0.95, 0.97)).startswith("mend grasp first")


@pytest.mark.parametrize(
    ("reasons", "points_at"),
    [
        ({"missed": 5, "slipped": 4, "all_grasps_blocked": 40}, "the grasp points"),
        ({"slipped": 3, "dropped": 2, "missed": 4}, "the grip"),
        ({"misplaced": 3, "slipped": 2}, "placing"),
        ({"ejected": 2, "timeout": 1, "misplaced": 2}, "the scenario"),
        ({"all_grasps_blocked": 7}, None),
    ],
)
def test_what_no_oracle_mends_points_at_what_its_reasons_say(reasons, points_at):
    sides = [side(0.5)] * 4
    summaries = [summary(s) for s in sides]
    summaries[-1]["reasons"] = reasons
    assert attribute(sides, summaries, FILES).rest_points_at == points_at


def test_the_verdict_names_the_grasp_points_that_failed():
    sides = [side(0.5)] * 4
    a = attribute(sides, [summary(s) for s in sides], FILES, {"rim": 2, "edge": 40})
    assert "; with edge 40, rim 2)" in verdict_line(a)


def test_parts_left_behind_are_seen_where_the_success_is_silent():
    """Whatever moved succeeded; without the arm in the way, more of the bin was cleared."""
    few = [Outcome(s, 20, 10 + s % 2, 10, 10, True) for s in range(12)]
    all_ = [Outcome(s, 20, 20, 20, 20, True) for s in range(12)]
    a = attribute([few, few, few, all_], [summary(x) for x in (few, few, few, all_)], FILES)
    assert (a.named, a.basis) == ("motion", "clearance")


def test_only_common_seeds_count_and_other_bins_are_refused():
    sides = [side(0.8, seeds=range(12)), side(0.8, seeds=range(2, 12)), side(0.9, seeds=range(9)), side(1.0)]
    assert attribute(sides, [summary(s) for s in sides], FILES).episodes == 7
    sides[3] = side(1.0, attempts=21)
    with pytest.raises(InputError, match=r"3\.sqlite"):
        attribute(sides, [summary(s) for s in sides], FILES)


def test_no_arm_ever_moved():
    idle = [Outcome(s, 5, 0, 0, 0, False) for s in range(3)]
    a = attribute([idle] * 4, [summary(idle)] * 4, FILES)
    assert a.named is None and a.stages[0].success is None and a.rest is None


@pytest.mark.slow
def test_a_planted_loss_is_named_through_real_campaigns(in_process, tmp_path):
    scenario = load_scenario("bracket", ["count=40"])
    a = run_modes(scenario, 6, 1, tmp_path, planted_oracles.run_episode, "test")
    gains = {s.name: s.success.difference for s in a.stages}
    for stage, cost in planted_oracles.COSTS.items():
        assert gains[stage] == pytest.approx(cost, abs=4 * np.sqrt(cost / 240))
    assert a.named == "grasp"
    document = json.loads((tmp_path / "attribution.json").read_text())
    assert document["named"] == "grasp" and [m["replaced"] for m in document["modes"]] == [list(m) for m in MODES]
    assert (tmp_path / "attribution.png").stat().st_size > 5000
    assert all((tmp_path / folder_of(m) / FILE).is_file() for m in MODES)


def test_results_are_not_continued_unasked(tmp_path, capsys):
    (tmp_path / "perception").mkdir()
    (tmp_path / "perception" / FILE).touch()
    assert main(["attribute", "bracket", "--out", str(tmp_path)]) == 2
    assert "--resume" in capsys.readouterr().err
    assert main(["attribute", "bracket", "--oracle", "grasp", "--out", str(tmp_path / "x")]) == 2
