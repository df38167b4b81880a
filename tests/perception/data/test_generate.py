"""`pickproof generate`: sets of settled scenes, and what trains and evaluates on them."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from pickproof.cell.errors import InputError
from pickproof.perception.data.scene_set import SceneSet
from pickproof.perception.data.scenes import GENERATED_SEED, heap_fingerprint
from pickproof.scenarios.commands.cli import main
from tests.perception.data.bop_checker import problems_of
from tests.perception.small_heaps import bracket, small_heaps

pytestmark = pytest.mark.slow

SMALL = ["--count", "1:3", "--seed", "7"]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def scenes(folder: Path) -> dict[str, np.ndarray]:
    with np.load(folder / f"heaps-bracket-{GENERATED_SEED + 7}.npz") as stored:
        return {key: stored[key] for key in stored.files}


def test_scenes_do_not_depend_on_workers_and_sets_grow(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["generate", "bracket", "--scenes", "1", *SMALL, "--out", "grown"]) == 0
    first = scenes(here / "grown")
    words = ["--export", "bop", "dataset", "--split", "val"]
    assert main(["generate", "bracket", "--scenes", "3", *SMALL, "--out", "grown", *words]) == 0
    assert main(["generate", "bracket", "--scenes", "3", *SMALL, "--out", "at_once", "--workers", "2"]) == 0
    grown, at_once = scenes(here / "grown"), scenes(here / "at_once")
    assert set(grown) == set(at_once) > set(first)
    for key, poses in at_once.items():
        np.testing.assert_array_equal(grown[key], poses)
        np.testing.assert_array_equal(first.get(key, poses), poses)
    assert {1, 2, 3} >= {len(poses) for key, poses in at_once.items() if key != "fingerprint"}
    assert cv2.imread("grown/scenes.png").std() > 10
    assert problems_of(here / "dataset", "val") == []
    assert "3 scenes" in capsys.readouterr().out
    assert main(["generate", "bracket", "--scenes", "3", "--count", "1:4", "--seed", "7", "--out", "grown"]) == 2
    assert "--seed 7 --count 1:3" in capsys.readouterr().err


def test_an_interrupted_run_keeps_its_scenes(here: Path) -> None:
    made = SceneSet.of(bracket(), here / "set", 7, 4, (1, 2))

    def interrupt(ready: int) -> None:
        if ready == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        made.heaps(1, interrupt)
    kept = scenes(here / "set")
    assert set(kept) == {str(GENERATED_SEED + 7), str(GENERATED_SEED + 8), "fingerprint"}
    ready = list[int]()
    assert len(made.heaps(1, ready.append)) == 4
    assert ready == [2, 3, 4]


def small_set(folder: Path, count: int) -> None:
    """A set that is stored already, so that nothing needs to settle."""
    made = SceneSet.of(bracket(), folder, 0, count, (8, 12))
    made.save("a test")
    heaps = {str(GENERATED_SEED + i): small_heaps()[i % 3] for i in range(count)}
    of = np.array(heap_fingerprint(made.workpiece))
    np.savez_compressed(folder / f"heaps-bracket-{GENERATED_SEED}.npz", **heaps, fingerprint=of)


def test_a_set_is_evaluated_and_trained_on(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    small_set(here / "set", 3)
    assert main(["evaluate", "bracket", "--data", "set", "--frames", "1", "--json", "--out", "e"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert (data["scenes"], data["methods"]["ps6d_refined"]["frames"]) == ("set", 1)
    assert data["methods"]["ps6d_refined"]["f1_inst"] > 80
    assert main(["train", "bracket", "--data", "set", "--clouds", "2", "--batch", "1", "--loaders", "0"]) == 0
    record = json.loads((here / "out/train/bracket/record.json").read_text())
    assert record["config"]["heaps"] == 3
    assert "--data set" in record["command"]
    assert not (here / "out/heaps").exists()


def test_a_set_of_what_has_changed_or_of_another_part(here: Path) -> None:
    small_set(here / "set", 2)
    with pytest.raises(InputError, match=r"workpiece.*'bracket'.*tless_20"):
        SceneSet.load(here / "set", "tless_20")
    path = here / "set" / "set.json"
    path.write_text(path.read_text().replace(json.loads(path.read_text())["fingerprint"], "0123456789abcdef"))
    with pytest.raises(InputError, match=r"fingerprint.*as it is now"):
        SceneSet.load(here / "set", "bracket")
    path.write_text("{}")
    with pytest.raises(InputError, match=r"set\.json.*pickproof generate bracket"):
        SceneSet.load(here / "set", "bracket")


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["brackett"], ["brackett", "bracket"]),
        (["bracket", "--scenes", "0"], ["--scenes", "1 to"]),
        (["bracket", "--seed", "-1"], ["--seed", "0 to"]),
        (["bracket", "--workers", "0"], ["--workers"]),
        (["bracket", "--views", "0"], ["--views"]),
        (["bracket", "--count", "5"], ["--count", "LOW:HIGH"]),
        (["bracket", "--count", "5:2"], ["--count", "5:2"]),
        (["bracket", "--export", "bop", "x", "--sensor", "sonar"], ["--sensor", "sonar", "stereo"]),
    ],
)
def test_bad_input_is_one_line(
    here: Path, words: list[str], names: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["generate", *words]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert all(name in error for name in names), error
    assert not (here / "out").exists()
