"""`pickproof benchmark perception` on two small heaps of brackets, with an untrained peer."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
import torch

from pickproof.cell.errors import InputError
from pickproof.cell.sensing.sensor_model import SensorConfig
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from pickproof.perception.benchmark import run as benchmark
from pickproof.perception.benchmark.frames import Job, Row, RowFrame, figures, measure_heap, stages_of
from pickproof.perception.benchmark.methods import ABLATIONS, METHODS, Method, methods_of
from pickproof.perception.benchmark.run import BenchmarkRequest
from pickproof.perception.benchmark.tables import FIGURES, HEADS, MEANS, markdown, mean_rows, table_cells
from pickproof.perception.data.scenes import HELD_OUT_SEED, heap_bin
from pickproof.perception.evaluation.heap_frames import Setup, perceive_heap
from pickproof.perception.ps6d.cloud import roi_mask, scene_cloud
from pickproof.perception.ps6d.network import Ps6d
from pickproof.perception.ps6d.variants import network_config
from pickproof.perception.ps6d.votes import Votes
from pickproof.perception.ps6d.weights import save_weights, weights_path
from pickproof.scenarios.commands.cli import main
from tests.perception.small_heaps import bracket, fill_folder, small_heaps

pytestmark = pytest.mark.slow


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    fill_folder(tmp_path / "out" / "heaps", HELD_OUT_SEED, 2)
    untrained(tmp_path / "variants" / "bracket" / "ppr_net_pp.safetensors", "ppr_net_pp")
    return tmp_path


def untrained(path: Path, variant: str, workpiece: Workpiece | None = None) -> None:
    workpiece = workpiece or bracket()
    torch.manual_seed(0)
    config = replace(network_config(variant, workpiece), channels=(8, 12, 16), features=16)
    save_weights(path, Ps6d(config), workpiece, {"command": "none"})


def methods(here: Path, ppf_frames: int = 1) -> list[Method]:
    return methods_of(bracket(), 2, ppf_frames, None, here / "variants")


def seen_by(kind: str, index: int) -> dict[Row, RowFrame]:
    method = next(m for m in methods_of(bracket(), 2, 2, None, None) if m.kind == kind)
    return measure_heap(Job("bracket", (method,), SensorConfig()), index, small_heaps()[index])


@lru_cache(maxsize=2)
def seen_by_ppf(index: int) -> dict[Row, RowFrame]:
    return seen_by("ppf", index)


@lru_cache(maxsize=2)
def seen_by_ps6d(index: int) -> dict[Row, RowFrame]:
    return seen_by("ps6d", index)


def test_json_is_the_same_as_in_one_process_and_resume_measures_nothing(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two workers against this process; every second stays as it was where nothing is measured again."""
    words = ["benchmark", "perception", "bracket", "--frames", "2", "--workers", "2", "--json", "--out", "result"]
    (here / "none").mkdir()
    words += ["--methods", "ppf", "ppr_net", "--variants-folder", "none"]
    assert main(words) == 0
    out = capsys.readouterr()
    data = json.loads(out.out)
    assert data == json.loads((here / "result" / "benchmark.json").read_text())
    assert {"command", "noise", "sensor", "workpieces", "ablations", "stages", "mean", "missing"} <= set(data)
    assert data["noise"] is True and data["ablations"] == {} and data["stages"] == {}
    (missing,) = data["missing"]
    assert missing["rows"] == ["ppr_net"] and missing["file"] == "none/bracket/ppr_net_pp.safetensors"
    line = next(line for line in out.err.splitlines() if line.startswith("bracket: no ppr_net:"))
    assert missing["file"] in line and "`pickproof train bracket --variant ppr_net_pp`" in line

    found = data["workpieces"]["bracket"]
    assert list(found["methods"]) == ["ppf"] == list(data["mean"])
    ppf = dict(found["methods"]["ppf"])
    assert set(ppf) == {*FIGURES, "settings"} and ppf.pop("seconds_per_frame") > 0
    expected = figures([seen_by_ppf(i)["methods", "ppf"] for i in range(2)], bracket())
    assert ppf.pop("settings") and ppf == {k: v for k, v in expected.items() if k in ppf}

    assert main([*words, "--resume"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert again["command"].endswith("--resume")
    assert again | {"command": data["command"]} == data
    assert "| bracket | ppf |" in (here / "result" / "benchmark.md").read_text()


def test_ps6d_sees_what_an_evaluation_sees() -> None:
    perception = Setup("bracket", None, SensorConfig(), HELD_OUT_SEED).load()
    result = perceive_heap(perception, small_heaps()[0], SensorConfig(), np.random.default_rng((HELD_OUT_SEED, 0)))
    detections = seen_by_ps6d(0)["methods", "ps6d_refined"].detections
    np.testing.assert_array_equal(detections.Ts_pred, result.Ts_estimated)
    np.testing.assert_array_equal(detections.scores, [e.score for e in result.result.estimates])
    fitted = seen_by_ps6d(0)["methods", "ps6d_fitted"].detections
    np.testing.assert_array_equal(fitted.scores, [e.score for e in result.result.fitted or ()])
    assert len(fitted.scores) > 0
    raw = seen_by_ps6d(0)["methods", "ps6d"].detections
    np.testing.assert_array_equal(raw.scores, [e.score for e in result.result.raw])
    before, after = (figures([seen_by_ps6d(0)["methods", row]], bracket()) for row in ("ps6d", "ps6d_refined"))
    assert after["f1_inst"] > 80 and after["ap_mssd"] > before["ap_mssd"]
    assert after["seconds_per_frame"] > before["seconds_per_frame"] > 0


def test_peers_run_and_ppf_sees_fewer_frames(here: Path) -> None:
    peers = tuple(m for m in methods(here) if m.kind != "ps6d")
    second = measure_heap(Job("bracket", peers, SensorConfig()), 1, small_heaps()[1])
    assert set(second) == {("methods", name) for name in ("ppr_net", "ppr_net_pp")}  # PPF: --ppf-frames 1
    assert all(found.seconds > 0 for found in second.values())
    ppf = seen_by_ppf(0)["methods", "ppf"]
    assert 0 < len(ppf.detections.Ts_pred) <= ppf.score.n_gt
    assert (ppf.detections.scores >= 1).all()  # votes, which compare frames


def test_a_network_with_confidence_hands_it_on(here: Path) -> None:
    peer = next(m for m in methods(here) if m.rows == ("ppr_net_pp",))
    perception = Setup("bracket", peer.weights, SensorConfig(), 0).load()
    frame = perceive_heap(perception, small_heaps()[0], SensorConfig(), np.random.default_rng(0)).frame
    cloud = scene_cloud(frame, roi_mask(frame, heap_bin(bracket())), bracket().unit)
    votes = perception.vote(cloud, np.random.default_rng(0))
    assert votes is not None and votes.confidence is not None
    assert votes.confidence.shape == (len(votes),)
    assert (votes.confidence > 0).all() and (votes.confidence < 1).all()


def test_votes_keep_their_confidence() -> None:
    points = np.zeros((3, 3))
    sure = np.array([0.1, np.nan, 0.3])
    votes = Votes(points, points, np.tile(np.eye(3), (3, 1, 1)), None, sure).finite()
    np.testing.assert_array_equal(votes.confidence, [0.1, 0.3])


def test_stages_add_up_and_the_forward_pass_is_timed() -> None:
    found = stages_of(Setup("bracket", None, SensorConfig(), HELD_OUT_SEED), [1], small_heaps()[1:2])
    seconds = dict(found["seconds"])
    assert seconds.pop("total") == pytest.approx(sum(seconds.values()))
    assert list(seconds) == ["network", "cluster", "surface", "hypotheses", "icp", "verify"]
    assert found["frames"] == 1 and found["parts"] == len(small_heaps()[1])
    assert set(found["forward"]) == {"input_points", "voting_points", "median_seconds", "repeats"}
    assert 0 < found["forward"]["median_seconds"] < seconds["network"]


def test_resume_keeps_rows_of_the_same_settings_alone(here: Path) -> None:
    asked = BenchmarkRequest(frames=2, ppf_frames=1, variants_folder=here / "variants")
    plan, sensor = benchmark._plan(asked, bracket()), SensorConfig()
    rows = {row: {"settings": benchmark._settings(m, bracket(), sensor)} for m in plan.methods for row in m.rows}
    assert set(rows) == set(METHODS)
    earlier = {"workpieces": {"bracket": {"methods": rows}}, "ablations": {}}

    def kept(frames: int, ppf_frames: int | None, sensor: SensorConfig = sensor) -> set[str]:
        asked = BenchmarkRequest(frames=frames, ppf_frames=ppf_frames, variants_folder=here / "variants")
        return {row for _, row in benchmark._known(earlier, benchmark._plan(asked, bracket()), sensor)}

    assert kept(2, 1) == set(METHODS)
    assert kept(2, None) == set(METHODS) - {"ppf"}
    assert kept(3, 1) == {"ppf"}
    assert kept(2, 1, sensor=SensorConfig(enabled=False)) == set()
    other = replace(network_config("ppr_net_pp", bracket()), channels=(8, 12, 20), features=16)
    save_weights(here / "variants" / "bracket" / "ppr_net_pp.safetensors", Ps6d(other), bracket(), {})
    assert kept(2, 1) == set(METHODS) - {"ppr_net", "ppr_net_pp"}


def test_ablations_are_those_of_the_paper_and_ours() -> None:
    part = replace(bracket(), name="ps6d_24")
    table = [m for m in methods_of(part, 5, 5, None, None) if m.table == "ablations"]
    assert [m.rows for m in table] == [(name, f"{name}_refined") for name in ABLATIONS]
    single = next(m for m in table if not m.two_stage)
    assert single.rows[0] == "single_stage" and single.weights == weights_path(part) and single.calibrated
    assert all(m.weights == part.folder / "variants" / f"{m.rows[0]}.safetensors" for m in table if m is not single)
    assert not any(m.calibrated for m in table if m is not single)


def test_ablations_are_resumed_too(here: Path) -> None:
    part = load_workpiece("ps6d_24")
    file = here / "variants" / "ps6d_24" / "no_cad_head.safetensors"
    untrained(file, "no_cad_head", part)
    plan = benchmark._plan(BenchmarkRequest(ablations=True, variants_folder=here / "variants"), part)
    assert ("ablations", "no_cad_head_refined") in plan.asked
    assert benchmark._known(benchmark.NOTHING, plan, SensorConfig()) == {}
    settings = benchmark._settings(plan.methods[-1], part, SensorConfig())
    assert plan.methods[-1].weights == file
    earlier = {"workpieces": {}, "ablations": {"ps6d_24": {"no_cad_head_refined": {"settings": settings}}}}
    assert set(benchmark._known(earlier, plan, SensorConfig())) == {("ablations", "no_cad_head_refined")}


def test_weights_of_another_variant_are_refused(here: Path) -> None:
    untrained(here / "variants" / "bracket" / "ppr_net_pp.safetensors", "no_cad_head")
    with pytest.raises(InputError, match="variant: 'no_cad_head' is not valid; expected ppr_net_pp"):
        benchmark._plan(BenchmarkRequest(variants_folder=here / "variants"), bracket())


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["--frames", "0"], ["--frames", "from 1 to 10000"]),
        (["--workers", "0"], ["--workers"]),
        (["--frames", "2", "--ppf-frames", "3"], ["--ppf-frames", "at most --frames"]),
        (["--methods", "icp"], ["--methods", "icp", "ppr_net_pp"]),
        (["--variants-folder", "nowhere"], ["--variants-folder", "nowhere"]),
        (["--methods", "ps6d", "--weights-folder", "variants"], ["ps6d.safetensors", "pickproof train bracket"]),
        (["brackett"], ["brackett", "bracket"]),
    ],
)
def test_bad_input_is_named(here: Path, words: list[str], names: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["benchmark", "perception", "bracket", *words]) == 2
    error = capsys.readouterr().err
    assert all(name in error for name in names)


@pytest.mark.parametrize("text", ["{", "[]", '{"workpieces": 3}'])
def test_a_damaged_result_is_named(here: Path, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "benchmark.json").write_text(text)
    assert main(["benchmark", "perception", "bracket", "--resume", "--out", "."]) == 2
    assert "benchmark.json" in capsys.readouterr().err


def row(value: float) -> dict[str, float]:
    return dict.fromkeys(MEANS, value) | {"frames": 2}


def test_means_are_over_the_workpieces_that_have_a_row() -> None:
    rows = {"a": {"ps6d": row(10.0), "ppf": row(3.0)}, "b": {"ps6d": row(30.0)}}
    means = mean_rows(rows)
    assert means["ps6d"]["f1_inst"] == 20 and means["ps6d"]["workpieces"] == 2
    assert means["ppf"]["recall"] == 3 and means["ppf"]["workpieces"] == 1
    assert [line[:3] for line in table_cells(rows)[-2:]] == [
        ["mean of 2", "ps6d", "20.00"],
        ["mean of 1", "ppf", "3.00"],
    ]


def test_markdown_rows_have_all_columns() -> None:
    empty = {"command": "c", "noise": True, "missing": [], "stages": {}, "ablations": {"a": {"no_cad_head": row(1.0)}}}
    text = markdown(empty | {"workpieces": {"a": {"methods": {"ps6d": row(1.0)}}}})
    lines = [line for line in text.splitlines() if line.startswith("|")]
    assert len(lines) == 8 and all(line.count("|") == len(HEADS) + 3 for line in lines)
    assert "## Table I: methods" in text and "## Table II: ablations" in text
