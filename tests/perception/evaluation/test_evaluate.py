"""`pickproof evaluate` with the shipped weights, on two heaps."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import cv2
import pytest

from pickproof.perception.data.scenes import HELD_OUT_SEED
from pickproof.perception.ps6d.weights import file_hash, weights_path
from pickproof.scenarios.commands.cli import main
from tests.perception.small_heaps import bracket, fill_folder, small_heaps

pytestmark = pytest.mark.slow


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    fill_folder(tmp_path / "out" / "heaps", HELD_OUT_SEED, 2)
    return tmp_path


@pytest.fixture(scope="module")
def in_one_process(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `pickproof evaluate` leaves of two frames."""
    folder = tmp_path_factory.mktemp("evaluated")
    fill_folder(folder / "out" / "heaps", HELD_OUT_SEED, 2)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert main(["evaluate", "bracket", "--frames", "2", "--out", "result"]) == 0
    return folder / "result"


def test_two_frames_of_the_shipped_weights(in_one_process: Path) -> None:
    data = json.loads((in_one_process / "evaluation.json").read_text())
    assert data["workpiece"] == "bracket"
    assert data["weights"] == file_hash(weights_path(bracket()))
    assert set(data["methods"]) >= {"ps6d", "ps6d_refined"}
    for method in data["methods"].values():
        keys = {"f1_inst", "recall", "precision", "median_mm", "median_deg", "frames", "seconds_per_frame"}
        assert keys <= set(method)
        assert method["frames"] == 2
        assert all(0 <= method[share] <= 100 for share in ("f1_inst", "recall", "precision"))
        stages = dict(method["seconds_per_frame"])
        assert stages.pop("total") == pytest.approx(sum(stages.values()))
    refined = data["methods"]["ps6d_refined"]
    assert refined["f1_inst"] > 80
    assert refined["median_mm"] < 1000 * bracket().tolerance / 2
    fitted, voted = (data["methods"][name]["median_mm"] for name in ("ps6d_fitted", "ps6d"))
    assert refined["median_mm"] < fitted < voted
    picture = cv2.imread(str(in_one_process / "evaluation.png"))
    assert picture is not None and picture.std() > 10
    with (in_one_process / "instances.csv").open() as file:
        instances = list(csv.DictReader(file))
    assert len(instances) == sum(len(heap) for heap in small_heaps()[:2])
    assert sum(row["count"] for row in data["recall_by_visibility"]) == len(instances)
    assert data["calibration"]["standing"]["bins"]
    page = (in_one_process / "evaluation.html").read_text()
    assert f"{refined['f1_inst']:.2f}" in page and page.count("data:image/png;base64,") == 2 + 4
    assert "<script" not in page and 'src="http' not in page


def test_json_alone_on_stdout_and_the_same_for_any_number_of_workers(
    here: Path, in_one_process: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", "bracket", "--frames", "2", "--workers", "2", "--json", "--out", "two"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data == json.loads((here / "two" / "evaluation.json").read_text())
    alone = json.loads((in_one_process / "evaluation.json").read_text())
    for found in (data, alone):
        del found["command"]
        for method in found["methods"].values():
            del method["seconds_per_frame"]
    assert data == alone
    assert (here / "two" / "instances.csv").read_bytes() == (in_one_process / "instances.csv").read_bytes()


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["bracket", "--frames", "0"], ["--frames", "1 to 1000000"]),
        (["bracket", "--seed", "-1"], ["--seed"]),
        (["bracket", "--workers", "0"], ["--workers", "1 to 256"]),
        (["bracket", "--sensor", "sonar"], ["--sensor", "sonar", "stereo", "structured_light"]),
        (["bracket", "--sensor", "stereo", "--no-noise"], ["--no-noise", "not allowed with", "--sensor"]),
        (["bracket", "--weights", "none.safetensors"], ["none.safetensors", "pickproof train bracket"]),
        (["brackett"], ["brackett", "bracket"]),
    ],
)
def test_bad_input_is_named(here: Path, words: list[str], names: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", *words]) == 2
    error = capsys.readouterr().err
    assert all(name in error for name in names)
