from dataclasses import replace

import pytest

from pickproof.scenarios.config.scenario import load_scenario
from pickproof.scenarios.results.records import AttemptRecord, EpisodeRecord
from pickproof.scenarios.results.store import Store
from pickproof.scenarios.results.summary import summarise
from tests.scenarios.planted_episode import write_campaign

PICK = AttemptRecord(0, 0, True, True, "", 6, 1, sensing_s=0.5, perceive_s=0.5, robot_s=2.0)
NO_PICK = AttemptRecord(0, 1, False, False, "all_grasps_blocked", 5, 3, sensing_s=0.5, perceive_s=0.5)


def summary_of(folder, records):
    write_campaign(folder, load_scenario("bracket"), range(0))
    with Store.resume(folder) as store:
        for i, record in enumerate(records):
            store.add_attempt(replace(record, attempt=i))
        store.add_episode(EpisodeRecord(0, 6, sum(r.success for r in records), "stuck", len(records), 1.0))
        return summarise(store)


@pytest.mark.parametrize("idle", [0, 1, 6])
def test_the_time_of_no_picks_counts_in_picks_an_hour(tmp_path, idle):
    s = summary_of(tmp_path, [PICK, PICK, *[NO_PICK] * idle])
    assert s["picks_per_hour"] == pytest.approx(3600 * 2 / (2 * 3.0 + idle * 1.0))
    assert s["cycle_s"]["total"] == pytest.approx(3.0)
    assert s["parts_left_per_episode"] == 4


def test_an_attempt_that_broke_down_takes_a_mean_cycle(tmp_path):
    broken = AttemptRecord(0, 0, True, False, "simulation_error", 5, 0)
    assert summary_of(tmp_path, [PICK, broken])["picks_per_hour"] == pytest.approx(3600 / 6.0)
    assert summary_of(tmp_path / "b", [broken])["picks_per_hour"] is None
