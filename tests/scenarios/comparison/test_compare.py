import json

import numpy as np
import pytest

from pickproof.cell.errors import InputError
from pickproof.scenarios.commands.cli import main
from pickproof.scenarios.comparison.compare import compare
from pickproof.scenarios.comparison.compare_text import differ_line, verdict_line, verdict_lines
from pickproof.scenarios.config.scenario import load_scenario
from pickproof.scenarios.results.records import AttemptRecord, EpisodeRecord
from pickproof.scenarios.results.store import Store
from tests.scenarios.planted_episode import write_campaign


@pytest.fixture
def campaign(tmp_path):
    def write(name, rate, seeds=range(20), overrides=(), **meta):
        scenario = load_scenario("bracket", ["count=10", f"carry.speed_scale={rate}", *overrides])
        write_campaign(tmp_path / name, scenario, seeds, **meta)
        return tmp_path / name

    return write


def test_a_worse_system_is_called_worse_and_the_other_way_round(campaign):
    a, b = campaign("a", 0.95), campaign("b", 0.8)
    c, back = compare(a, b), compare(b, a)
    assert (c.verdict, back.verdict, c.basis) == ("worse", "better", "success")
    assert c.success.interval95[1] < 0 and c.episodes == 20 and c.left_out == 0
    assert back.success.interval95 == pytest.approx((-c.success.interval95[1], -c.success.interval95[0]))
    assert c.changed == ["carry.speed_scale"]
    # all that the lower rate adds is slipped, by the planted episode
    assert c.reasons["slipped"].difference > 0.05
    assert abs(c.reasons["missed"].difference) < 0.02


def test_first_attempts_by_hand(campaign):
    """Luck of the first attempt in 200 bins between 0.8 and 0.95: those pairs, and no others, are discordant."""
    luck = np.array([np.random.default_rng((seed, 1)).random(80)[0] for seed in range(200)])
    only_a = int(((luck >= 0.8) & (luck < 0.95)).sum())
    f = compare(campaign("a", 0.95, range(200)), campaign("b", 0.8, range(200))).first_attempts
    assert (f.only_a, f.only_b, f.both) == (only_a, 0, int((luck < 0.8).sum()))
    assert f.p == pytest.approx(2 * 0.5**only_a)
    assert f.difference == pytest.approx(-only_a / 200)


def test_the_same_system_gives_no_evidence_and_a_number_of_episodes(campaign):
    c = compare(campaign("a", 0.9), campaign("b", 0.9))
    assert c.verdict == "no evidence" and c.success.difference == 0 and c.changed == []
    assert c.success.interval95[0] < 0 < c.success.interval95[1]
    assert c.more_to_show is None
    assert "no number of episodes" in verdict_line(c)


def test_more_episodes_do_decide(campaign):
    """The number of episodes that is asked for turns "no evidence" into a verdict."""
    c = compare(campaign("a", 0.95, range(10)), campaign("b", 0.92, range(10)))
    assert c.verdict == "no evidence" and c.more_to_show
    n = 10 + c.more_to_show
    assert compare(campaign("c", 0.95, range(n)), campaign("d", 0.93, range(n))).verdict == "worse"


def test_only_common_seeds_count(campaign):
    c = compare(campaign("a", 0.95, range(20)), campaign("b", 0.95, range(15, 25)))
    assert (c.episodes, c.left_out) == (5, 20)


def test_other_stop_rules_leave_the_first_attempts(campaign):
    c = compare(campaign("a", 0.95), campaign("b", 0.95, overrides=["stop.attempt_limit=1"]))
    assert c.success is None and c.clearance is None and c.basis == "first_attempts"
    assert "stop.attempt_limit" in c.changed


def test_oracle_and_weights_are_named(campaign):
    c = compare(campaign("a", 0.95), campaign("b", 0.95, oracle=["perception"], weights_hash="0"))
    assert c.changed == ["oracle", "weights_hash"]


@pytest.mark.parametrize(
    ("seeds", "overrides", "words"),
    [
        (range(50, 60), (), ["seeds", "50 to 59", "0 to 19"]),
        (range(20), ("count=11",), ["count", "same bins"]),
        (
            range(20),
            ("source_bin.yaw=0.1", "physics.solver_iterations=60"),
            ["physics.solver_iterations, source_bin.yaw"],
        ),
    ],
)
def test_other_bins_are_refused_in_one_line(campaign, capsys, seeds, overrides, words):
    a, b = campaign("a", 0.95), campaign("b", 0.95, seeds, overrides)
    with pytest.raises(InputError):
        compare(a, b)
    assert main(["compare", str(a), str(b)]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    for word in words:
        assert word in err


def test_bins_that_were_filled_otherwise_are_refused(campaign):
    a, b = campaign("a", 0.95), campaign("b", 0.95, range(3))
    with Store.resume(b) as store:
        store.add_episode(EpisodeRecord(7, 9, 9, "cleared", 0, 0.0))
    with pytest.raises(InputError, match="seed 7: 9 is not valid; expected 10"):
        compare(a, b)


def timed(out, seeds, cycle_s, no_pick_s=0.0, scenario=("count=10",), picked=10):
    """Episodes of successful picks that take `cycle_s` and one no-pick; noise is the same in every campaign."""
    write_campaign(out, load_scenario("bracket", scenario), range(0), seed=0)
    with Store.resume(out) as store:
        for seed in seeds:
            noise = np.random.default_rng(seed).normal(0, 0.02, picked)
            for i in range(picked):
                store.add_attempt(AttemptRecord(seed, i, True, True, "", 10 - i, 1, robot_s=cycle_s + noise[i]))
            if no_pick_s:
                idle = AttemptRecord(seed, picked, False, False, "no_detection", 0, 0, sensing_s=no_pick_s)
                store.add_attempt(idle)
            store.add_episode(EpisodeRecord(seed, 10, picked, "stuck", picked + bool(no_pick_s), 1.0))
    return out


def test_a_slower_cell_is_worse_in_cycle_and_picks_an_hour_alone(tmp_path):
    c = compare(timed(tmp_path / "a", range(6), 2.0), timed(tmp_path / "b", range(6), 2.2))
    assert c.verdicts == {
        "success": "no evidence", "clearance": "no evidence", "cycle": "worse", "picks_per_hour": "worse"
    }  # fmt: skip
    assert c.cycle.difference == pytest.approx(0.2) and c.cycle.interval95[0] > 0.15
    assert c.picks_per_hour.a == pytest.approx(1800, rel=0.02)
    assert any("worse: cycle 2." in line for line in verdict_lines(c))


def test_no_picks_cost_picks_an_hour_and_not_the_cycle(tmp_path):
    c = compare(timed(tmp_path / "a", range(6), 2.0), timed(tmp_path / "b", range(6), 2.0, no_pick_s=4.0))
    assert (c.verdicts["cycle"], c.verdicts["picks_per_hour"]) == ("no evidence", "worse")
    assert c.picks_per_hour.b == pytest.approx(c.picks_per_hour.a * 20 / 24, rel=0.01)


def test_lost_clearance_is_a_verdict_of_its_own(tmp_path):
    c = compare(timed(tmp_path / "a", range(6), 2.0), timed(tmp_path / "b", range(6), 2.0, picked=6))
    assert c.verdict == "no evidence" and c.verdicts["clearance"] == "worse"
    assert c.clearance.difference == pytest.approx(-0.4)


def test_what_differs_is_said_with_both_values(campaign):
    c = compare(campaign("a", 0.95), campaign("b", 0.8, oracle=["perception"], weights_hash="0f" * 32))
    line = differ_line(c.differ)
    for words in ("carry.speed_scale 0.95 -> 0.8", "oracle none -> perception", "weights_hash none -> 0f0f0f0f0f"):
        assert words in line
    assert list(c.differ) == c.changed


def test_command(campaign, tmp_path, capsys):
    a, b = campaign("a", 0.95), campaign("b", 0.8)
    assert main(["compare", str(a), str(b), "--json", str(tmp_path / "c.json")]) == 0
    out = capsys.readouterr().out
    assert "worse: pick success" in out and "McNemar" in out and "slipped" in out
    document = json.loads((tmp_path / "c.json").read_text())
    assert document["verdict"] == "worse" and document["first_attempts"]["only_b"] == 0
