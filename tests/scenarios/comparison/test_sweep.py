import json

import pytest

from pickproof.cell.errors import InputError
from pickproof.scenarios.comparison.sweep import parse_axis, plan
from pickproof.scenarios.results.store import FILE


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("sensor.axial_sigma=1e-4,2e-4", ("1e-4", "2e-4")),
        ("count=10:40:10", ("10", "20", "30", "40")),
        ("carry.speed_scale=0.1:0.4:0.1", ("0.1", "0.2", "0.3", "0.4")),
        ("source_bin.inner=[0.2, 0.2, 0.06],[0.3, 0.2, 0.06]", ("[0.2, 0.2, 0.06]", "[0.3, 0.2, 0.06]")),
        ("gripper=jaw_v1", ("jaw_v1",)),
    ],
)
def test_values(text, values):
    assert parse_axis(text).values == values


@pytest.mark.parametrize(
    "text", ["count", "count=", "=3", "count=1,,2", "count=1:9:0", "count=9:1:1", "count=a:b:c", "count=10:30"]
)
def test_bad_values(text):
    with pytest.raises(InputError, match="--set"):
        parse_axis(text)


def test_every_combination_is_checked_before_the_first_runs(tmp_path):
    with pytest.raises(InputError, match="count"):
        plan("bracket", [parse_axis("count=1,2,0")], None, tmp_path)
    with pytest.raises(InputError, match="combinations"):
        plan("bracket", [parse_axis("count=1:100:1"), parse_axis("seed=1,2,3")], None, tmp_path)


@pytest.mark.slow
def test_command_is_resumable(planted, tmp_path, capsys):
    out = tmp_path / "sweep"
    words = ["sweep", "bracket", "--out", str(out), "--episodes", "4", "--set", "count=10"]
    assert planted(*words, "--set", "carry.speed_scale=0.7,0.95") == 0
    table = capsys.readouterr().out
    assert "carry.speed_scale" in table and (out / "sweep.png").stat().st_size > 5000
    rows = json.loads((out / "sweep.json").read_text())["rows"]
    assert rows[0]["summary"]["success_rate"] < rows[1]["summary"]["success_rate"]
    files = {p: p.stat().st_mtime_ns for p in out.glob(f"*/{FILE}")}
    first = {r["folder"]: r["summary"]["record_hash"] for r in rows}
    assert planted(*words, "--set", "carry.speed_scale=0.7,0.8,0.95") == 0
    again = {r["folder"]: r["summary"]["record_hash"] for r in json.loads((out / "sweep.json").read_text())["rows"]}
    assert len(again) == 3 and first.items() <= again.items() and len(files) == 2
