import json
from xml.etree import ElementTree

import pytest

from pickproof.cell.errors import InputError
from pickproof.scenarios.commands.cli import main
from pickproof.scenarios.comparison.baseline import Execution, baseline_of, read_baseline, write_baseline
from pickproof.scenarios.comparison.gate import junit, run_gate
from pickproof.scenarios.config.scenario import load_scenario
from pickproof.scenarios.statistics.sequential_test import Rule
from tests.scenarios.planted_episode import run_episode, write_campaign


def scenario(rate, *more):
    return load_scenario("bracket", ["count=10", f"carry.speed_scale={rate}", *more])


@pytest.fixture
def baseline(tmp_path):
    """Of 400 first attempts at a rate of 0.95."""
    write_campaign(tmp_path / "a", scenario(0.95, "stop.attempt_limit=1"), range(400))
    return write_baseline(tmp_path / "bracket.json", baseline_of(tmp_path / "a"))


def gate(rate, path, out, workers=1, resume=False, **options):
    how = Execution(out, run_episode, workers, resume=resume)
    return run_gate(scenario(rate), read_baseline(path), file=path, rule=Rule(), how=how, **options)


def test_baseline_comes_back_and_is_small(baseline, tmp_path):
    again = read_baseline(baseline)
    assert again == baseline_of(tmp_path / "a")
    assert not again.whole and len(again.rows) == 400 and again.scenario_hash
    text = baseline.read_text()
    assert len(text) < 20_000 and text.count("\n") > 400
    assert write_baseline(tmp_path / "again.json", again).read_text() == text


@pytest.mark.parametrize(("rate", "decision"), [(0.95, "passed"), (0.85, "worse")])
def test_decisions(in_process, baseline, tmp_path, rate, decision):
    result = gate(rate, baseline, tmp_path / "out")
    assert result.decision == decision
    assert result.episodes < 250
    assert result.bounds[0] <= result.candidate - result.baseline <= result.bounds[1]
    assert (result.bounds[1] < 0) == (decision == "worse") or result.bounds[1] < 0.05
    case = ElementTree.fromstring(junit(result, "bracket"))[0]
    assert case.get("failures") == str(int(decision == "worse")) and case.get("errors") == "0"


@pytest.mark.slow
def test_undecided_at_the_limit_and_resumed_to_a_decision(baseline, tmp_path, request):
    straight = gate(0.95, baseline, tmp_path / "straight", workers=2)
    request.getfixturevalue("in_process")
    out = tmp_path / "out"
    first = gate(0.95, baseline, out, max_episodes=40)
    assert (first.decision, first.episodes) == ("undecided", 40)
    assert ElementTree.fromstring(junit(first, "bracket"))[0].get("errors") == "1"
    resumed = gate(0.95, baseline, out, resume=True)
    assert resumed == straight
    assert gate(0.95, baseline, out, resume=True) == resumed  # nothing left to run


def test_whole_episodes(in_process, tmp_path):
    write_campaign(tmp_path / "a", scenario(0.95), range(250))
    path = write_baseline(tmp_path / "b.json", baseline_of(tmp_path / "a"))
    result = gate(0.85, path, tmp_path / "out", measure="success")
    assert result.decision == "worse" and -0.2 < result.candidate - result.baseline < -0.05


def test_what_cannot_be_compared_is_refused(baseline, tmp_path):
    with pytest.raises(InputError, match="--whole"):
        gate(0.95, baseline, tmp_path / "out", measure="success")
    with pytest.raises(InputError, match=r"count: .* same bins"):
        run_gate(
            load_scenario("bracket"), read_baseline(baseline), file=baseline, rule=Rule(),
            how=Execution(tmp_path / "out", run_episode),
        )  # fmt: skip
    assert not (tmp_path / "out").exists()


def test_bad_baselines_are_one_line(tmp_path, capsys):
    path = tmp_path / "b.json"
    words = ["gate", "bracket", "--baseline", str(path)]
    for text, expected in ((None, "missing file"), ("{", "JSON"), ("{}", "name"), ("[]", "")):
        if text is not None:
            path.write_text(text)
        assert main(words) == 2
        err = capsys.readouterr().err
        assert err.count("\n") == 1 and expected in err and "b.json" in err


def test_gaps_are_refused(baseline):
    data = json.loads(baseline.read_text())
    del data["rows"][3]
    baseline.write_text(json.dumps(data))
    with pytest.raises(InputError, match="consecutive"):
        read_baseline(baseline)


@pytest.mark.slow
def test_commands(planted, tmp_path, capsys):
    base = ["--set", "count=10", "--set", "carry.speed_scale"]
    assert planted("baseline", "bracket", *base[:3], "carry.speed_scale=0.95", "--episodes", "120") == 0
    assert "bracket.baseline.json: 120 episodes" in capsys.readouterr().out
    words = ["gate", "bracket", *base[:3]]
    files = ["--baseline", "bracket.baseline.json", "--json", "g.json", "--junit", "g.xml"]
    assert planted(*words, "carry.speed_scale=0.8", *files) == 1
    worse = capsys.readouterr().out
    assert worse.startswith("worse: ") and worse.count("\n") == 1
    assert json.loads((tmp_path / "g.json").read_text())["changed"] == [
        "carry.speed_scale"
    ]  # versions and weights are the same
    assert "carry.speed_scale" in ElementTree.parse(tmp_path / "g.xml").findtext(".//failure")
    assert planted(*words, "carry.speed_scale=0.95", *files) == 3
    assert "after 120 paired episodes" in capsys.readouterr().out
    assert planted(*words, "carry.speed_scale=0.95", *files, "--margin", "0.05") == 0
    assert planted("gate", "bracket", *files) == 2
