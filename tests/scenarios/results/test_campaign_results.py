import json
import subprocess
import sys

import pytest

from pickproof import Campaign
from pickproof.cell.errors import InputError
from pickproof.scenarios.commands.cli import main
from pickproof.scenarios.config.scenario import load_scenario
from pickproof.scenarios.results.store import Store
from pickproof.scenarios.results.summary import summarise
from tests.scenarios.planted_episode import write_campaign


@pytest.fixture
def folder(tmp_path):
    write_campaign(tmp_path / "run", load_scenario("bracket", ["count=10", "carry.speed_scale=0.8"]), range(5))
    return tmp_path / "run"


def test_a_campaign_opens_typed(folder):
    campaign = Campaign.open(folder)
    with Store.read(folder) as store:
        assert list(campaign.attempts) == store.attempts()
        assert list(campaign.episodes) == store.episodes()
        assert campaign.summary == summarise(store)
    with pytest.raises(InputError, match="missing file"):
        Campaign.open(folder / "nothing")


def test_a_frame_has_a_row_an_attempt(folder):
    pytest.importorskip("pandas", reason="pickproof[data] is not installed")
    campaign = Campaign.open(folder)
    frame = campaign.to_frame()
    assert len(frame) == len(campaign.attempts)
    moved = frame[frame.moved]
    assert moved.success.mean() == pytest.approx(campaign.summary["success_rate"])
    failed = frame[~frame.success].reason.value_counts().to_dict()
    assert failed == campaign.summary["reasons"]
    assert frame.cycle_s.tolist() == [a.cycle_s for a in campaign.attempts]
    assert set(frame.end) <= {"cleared", "stuck", "stopped"}


def test_parquet_holds_every_bit(folder, capsys):
    parquet = pytest.importorskip("pyarrow.parquet", reason="pickproof[data] is not installed")
    file = folder / "new" / "attempts.parquet"
    assert main(["export", str(folder), "--parquet", str(file)]) == 0
    table, campaign = parquet.read_table(file), Campaign.open(folder)
    assert table.num_rows == len(campaign.attempts)
    assert f"{table.num_rows} attempts" in capsys.readouterr().out
    for row, a in zip(table.to_pylist(), campaign.attempts, strict=True):
        assert (row["seed"], row["attempt"], row["reason"], row["error_mm"]) == (
            a.seed,
            a.attempt,
            a.reason,
            a.error_mm,
        )
        assert tuple(map(tuple, row["part_poses_after"])) == a.part_poses_after
        assert row["tree"] is None if a.tree is None else json.loads(row["tree"]) == a.tree
    told = json.loads(table.schema.metadata[b"pickproof"])
    assert told["scenario_hash"] == campaign.summary["scenario_hash"]


def test_what_cannot_be_written_is_one_line(folder, capsys):
    pytest.importorskip("pyarrow", reason="pickproof[data] is not installed")
    (folder / "file").touch()
    assert main(["export", str(folder), "--parquet", str(folder / "file" / "a.parquet")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_missing_libraries_are_named(folder, monkeypatch, capsys):
    for name in ("pandas", "pyarrow"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(InputError, match=r"pickproof\[data\]"):
        Campaign.open(folder).to_frame()
    assert main(["export", str(folder), "--parquet", "a.parquet"]) == 2
    assert "pickproof[data]" in capsys.readouterr().err


def test_the_import_is_light():
    code = "import sys, pickproof.scenarios; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"numpy", "rich", "pydantic", "pandas", "torch"} & set(loaded)
