import shutil

import pytest

from pickproof.cell.errors import InputError, PickproofError
from pickproof.scenarios.campaign.campaign import run_campaign
from pickproof.scenarios.campaign.request import CampaignRequest
from pickproof.scenarios.config.scenario import load_scenario
from pickproof.scenarios.config.shipped import WORKPIECES
from pickproof.scenarios.results.record_hash import record_hash
from pickproof.scenarios.results.records import Reason
from pickproof.scenarios.results.store import Store
from pickproof.scenarios.results.summary import summarise
from tests.scenarios.fake_episode import run_episode

pytestmark = pytest.mark.slow


def campaign(out, episodes=2, workers=1, gripper="jaw_v1", count=6, on_event=lambda event: None, **options):
    request = CampaignRequest(
        scenario=load_scenario("bracket", [f"gripper='{gripper}'", f"count={count}", "stop.attempt_limit=20"]),
        **{"episodes": episodes, "seed": 3, "workers": workers, "out": out, **options},
        runner=run_episode,
    )
    run_campaign(request, on_event)
    with Store.read(out) as store:
        return store.attempts(), store.episodes(), summarise(store)


@pytest.fixture(scope="module")
def calm(tmp_path_factory):
    """Record hash of `campaign` as it is called by default, in peace."""
    return campaign(tmp_path_factory.mktemp("calm"))[2]["record_hash"]


def test_one_worker_or_two_or_resumed_the_same_records(tmp_path):
    order = []
    attempts, episodes, one = campaign(
        tmp_path / "one",
        episodes=4,
        expected_s={3: 1.0, 4: 2.0, 5: 3.0},
        on_event=lambda event: order.append(event.seed) if event.episode else None,
    )
    assert order == [5, 4, 6, 3]  # longest first, 6 taken for average
    assert [e.seed for e in episodes] == [3, 4, 5, 6]
    assert len(attempts) == sum(e.attempts for e in episodes)
    *_, two = campaign(tmp_path / "two", episodes=4, workers=2)
    campaign(tmp_path / "resumed", episodes=1)
    with Store.resume(tmp_path / "resumed") as store:  # an episode that did not end
        for a in attempts:
            if a.seed == 4 and a.attempt < 2:
                store.add_attempt(a)
    seen = []
    *_, resumed = campaign(tmp_path / "resumed", episodes=4, resume=True, on_event=seen.append)
    assert one["record_hash"] == two["record_hash"] == resumed["record_hash"]
    assert {event.seed for event in seen} == {4, 5, 6}


def test_changed_inputs_are_not_resumed(tmp_path, monkeypatch):
    shutil.copytree(WORKPIECES / "bracket", tmp_path / "parts" / "bracket", ignore=shutil.ignore_patterns("variants"))
    monkeypatch.setenv("PICKPROOF_WORKPIECES", str(tmp_path / "parts"))
    *_, s = campaign(tmp_path / "run", episodes=1)
    assert len(s["inputs_hash"]) == 64
    (tmp_path / "parts" / "bracket" / "grasps.yaml").write_text("[]")
    with pytest.raises(InputError, match=r"--resume .*: 'changed: inputs\.grasps\.yaml' is not valid") as refused:
        campaign(tmp_path / "run", resume=True)
    assert "\n" not in str(refused.value)


def test_another_campaign_is_not_resumed(tmp_path):
    campaign(tmp_path)
    for change, name in (
        ({"seed": 4}, "seed"),
        ({"count": 7}, "scenario_hash"),
        ({"oracle": frozenset({"perception"})}, "oracle"),
        ({"weights_hash": "00"}, "weights_hash"),
        ({"episodes": 1}, "--episodes"),
    ):
        with pytest.raises(PickproofError, match=name):
            campaign(tmp_path, resume=True, **change)
    with pytest.raises(PickproofError, match="--out"):
        campaign(tmp_path)


@pytest.mark.parametrize(("how", "retries"), [("dies_once", 1), ("killed", 2)])
def test_a_worker_that_crashes_or_is_killed_costs_retries_and_nothing_else(tmp_path, calm, how, retries):
    marker, seen = tmp_path / "died", []  # the gripper's name is part of neither attempts nor outcomes
    *_, s = campaign(tmp_path / "run", gripper=f"{how}:{marker}", on_event=seen.append)
    assert sum(e.attempt is None and e.episode is None for e in seen) == retries
    assert s["record_hash"] == calm


def test_an_episode_that_crashes_two_workers_is_a_simulation_error(tmp_path):
    attempts, episodes, s = campaign(tmp_path, episodes=1, gripper="dies")
    assert [e.end for e in episodes] == ["stopped"]
    assert [a.attempt for a in attempts] == [0, 1, 2]
    last = attempts[-1]
    assert last.moved and last.reason is Reason.SIMULATION_ERROR
    assert "died" in last.tree["error"]
    assert s["reasons"]["simulation_error"] == 1


def test_a_worker_without_word_is_taken_for_dead(tmp_path):
    seen = []
    attempts, _, _ = campaign(tmp_path, episodes=1, gripper="hangs", stall_s=3.0, on_event=seen.append)
    assert sum(e.attempt is None and e.episode is None for e in seen) == 1
    assert attempts[-1].reason is Reason.SIMULATION_ERROR
    assert "no word" in attempts[-1].tree["error"]


def test_a_broken_simulation_is_not_tried_twice(tmp_path):
    seen = []
    attempts, episodes, _ = campaign(tmp_path, episodes=1, gripper="broken", on_event=seen.append)
    assert attempts[-1].tree == {"error": "a workpiece is at infinity"}
    assert [e.attempts for e in episodes] == [3]
    assert len(seen) == 4


def test_bugs_and_bad_input_of_a_worker_reach_the_driver(tmp_path):
    with pytest.raises(RuntimeError, match=r"fake_episode\.py(.|\n)*no such thing as a free lunch"):
        campaign(tmp_path / "a", gripper="buggy")
    with pytest.raises(PickproofError, match=r"weights\.safetensors: hash"):
        campaign(tmp_path / "b", gripper="bad_input")
    with Store.read(tmp_path / "b") as store:
        assert len(store.attempts()) >= 2
        assert record_hash(store.attempts(), []) != record_hash([], [])
