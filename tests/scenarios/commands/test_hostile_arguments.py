"""Wrong values for the options of every command: one line, exit code 2, and nothing begun."""

from __future__ import annotations

import os
import shlex
from pathlib import Path

import pytest

from pickproof.scenarios.commands import cli
from pickproof.scenarios.commands.arguments import parse_file_to_write as file_to_write
from pickproof.scenarios.commands.arguments import parse_folder_to_write as folder_to_write
from pickproof.scenarios.commands.arguments import parse_number as number
from pickproof.scenarios.files.atomic import write_whole
from tests.fuzzing.arguments import check, furnish

pytestmark = pytest.mark.slow

REFUSED = (
    "train bracket --minutes nan",
    "train bracket --minutes -1",
    "train bracket --minutes inf --variant nosuch",
    "train bracket --clouds 0",
    "train bracket --batch -1",
    "train bracket --lr nan",
    "train bracket --seed -1",
    "train bracket --loaders -1",
    "train bracket --init nosuch",
    "train bracket --bop missing",
    "train bracket --data missing",
    "train bracket --variant nosuch",
    "train bracket --seed 99999999999999999999 --variant nosuch",
    "train bracket --lr 1e9 --init nosuch",
    "evaluate bracket --frames 0",
    "evaluate bracket --frames nan",
    "evaluate bracket --seed -1",
    "evaluate bracket --workers 0",
    "evaluate bracket --weights file",
    "evaluate bracket --weights folder",
    "evaluate bracket --weights missing",
    "evaluate bracket --sensor nosuch",
    "evaluate bracket --data file",
    "evaluate bracket --bop file",
    "evaluate bracket --bop-results folder",
    "fit-score bracket --frames 1",
    "fit-score bracket --workers 0",
    "fit-score bracket --out missing/x",
    "fit-score bracket --weights file",
    "generate bracket --scenes 0",
    "generate bracket --seed -1",
    "generate bracket --workers 1000",
    "generate bracket --count 5",
    "generate bracket --count 2:1",
    "generate bracket --views 0",
    "generate bracket --export coco x",
    "generate bracket --export bop x --split bad",
    "generate bracket --export bop x --sensor nosuch",
    "generate bracket --out file",
    "generate bracket --count 1:99999999 --out file",
    "perceive bracket missing.png",
    "perceive bracket folder",
    "perceive bracket file",
    "perceive bracket file --fx nan --fy 1 --cx 1 --cy 1",
    "perceive bracket file --fx 1",
    "perceive bracket file --depth-scale nan",
    "perceive bracket file --sigma -1",
    "perceive bracket file --seed -1",
    "perceive bracket file --roi 0 0 0 nan 1 1",
    "perceive bracket missing.ply --unit furlong",
    "benchmark perception bracket --frames 0",
    "benchmark perception bracket --methods luck",
    "benchmark perception bracket --workers 0",
    "benchmark perception bracket --weights-folder missing",
    "benchmark perception bracket --ppf-frames 99",
    "benchmark perception bracket --out file --weights-folder folder",
    "benchmark perception bracket --resume --out file --weights-folder folder",
    "benchmark motion --picks 1",
    "benchmark motion bracket --json folder",
    "benchmark campaign --episodes 1",
    "benchmark gate --campaigns 1",
    "benchmark gate --json folder",
    "run bracket --set count=1e999",
    "run bracket --set count=nan",
    "run bracket --set wrist.noise_N=nan",
    "run bracket --set wrist.noise_N=.nan",
    "run bracket --set camera.eye=[1,2]",
    "run bracket --set count=2001-99-99",
    "run bracket --out file",
    "run bracket --out file/x",
    "run bracket --out campaign",
    "run bracket --resume",
    "run bracket --resume --out missing",
    "run bracket --resume --out file",
    "run file.yaml",
    "run folder.yaml",
    "run locked.yaml",
    "run missing.yaml",
    "run bracket --seed 2147483647 --episodes 2",
    "run bracket --set grasps=folder",
    "run bracket --set grasps=missing",
    "run bracket --set grasps=file",
    "run bracket --set workpiece=nosuch",
    "run bracket --set robot=lrmate200",
    "run bracket --set place.kind=nosuch",
    "run bracket --set source_bin.inner=[-1,1,1]",
    "run bracket --set physics.timestep=1",
    "sweep bracket",
    "sweep bracket --set count=1:2",
    "sweep bracket --set count=1:1e9:1",
    "sweep bracket --set count=",
    "sweep bracket --set count=1,nan",
    "sweep bracket --set a=1,2",
    "sweep bracket --set count=1,2 --out file",
    "sweep bracket --set count=nan:1:1",
    "sweep bracket --set count=1:inf:1",
    "attribute bracket --oracle grasp",
    "attribute bracket --out file",
    "attribute bracket --episodes 1",
    "tune bracket --shift nan",
    "tune bracket --turn -1",
    "tune bracket --budget nan",
    "tune bracket --budget 0s",
    "tune bracket --grasps nosuch",
    "tune bracket --grasps ''",
    "tune bracket --errors file",
    "tune bracket --errors folder",
    "tune bracket --errors missing",
    "tune bracket --set a.b=1:2",
    "tune bracket --set count=1:2",
    "tune bracket --set wrist.noise_N=nan:1",
    "tune bracket --accept",
    "tune bracket --accept --out missing",
    "tune bracket --accept --out folder",
    "tune bracket --resume --out folder",
    "tune bracket --block 9",
    "tune bracket --out file",
    "tune bracket --set wrist.noise_N=-1:2",
    "tune bracket --seed 2147483647",
    "gate bracket --baseline missing",
    "gate bracket --baseline file",
    "gate bracket --baseline folder",
    "gate bracket --baseline file --margin nan",
    "gate bracket --baseline file --margin 0",
    "gate bracket --baseline file --alpha 1",
    "gate bracket --baseline file --json folder",
    "gate bracket --baseline file --junit file/x",
    "gate bracket --baseline file --resume",
    "gate bracket --baseline file --max-episodes 0",
    "baseline missing",
    "baseline folder",
    "baseline campaign --baseline folder",
    "baseline campaign --baseline file/x",
    "baseline bracket --episodes 0",
    "explain campaign --attempt nan",
    "explain campaign --attempt -1",
    "explain campaign --attempt 99",
    "explain folder --attempt 0",
    "explain file --attempt 0",
    "explain missing --attempt 0",
    "replay campaign --attempt 0 --record x.avi",
    "replay campaign --attempt 0 --port 99999",
    "export-program campaign --attempt 0",
    "export-program campaign --attempt 0 --output 0",
    "export campaign --parquet folder",
    "export campaign --parquet file/x",
    "export folder --parquet a",
    "index missing",
    "index folder",
    "index file",
    "index campaign --out folder",
    "compare campaign folder",
    "compare campaign campaign --json folder",
    "report folder",
    "report file",
    "report campaign --out folder",
    "grasps import bracket missing",
    "grasps import bracket file",
    "grasps import bracket folder",
    "grasps import bracket file --tool nan 0 0 0 0 0",
    "grasps export bracket --out folder",
    "grasps export bracket --gripper nosuch",
    "grasps export bracket --gripper file.yaml",
    "grasps export bracket --gripper folder.yaml",
    "grasps sample bracket --count 0",
    "grasps sample bracket --least nan",
    "grasps sample bracket --least 1",
    "grasps sample bracket --seed -1",
    "grasps sample bracket --count 1e9",
    "grasps edit bracket --grasps folder",
    "grasps edit bracket --grasps file",
    "grasps edit bracket --port -1",
    "grasps robustness bracket --grasps nosuch",
    "grasps robustness bracket --table folder",
    "grasps robustness bracket --table file",
    "grasps robustness bracket --errors file",
    "grasps robustness bracket --errors folder",
    "grasps robustness bracket --out file",
    "grasps check nosuch",
    "onboard missing.stl --unit mm --name a",
    "onboard folder --unit mm --name a",
    "onboard file --unit mm --name a",
    "onboard file.stl --unit mm --name ../a",
    "onboard file.stl --unit mm --name ''",
    "onboard file.stl --unit parsec --name a",
    "onboard file.stl --unit mm --name a --material cheese",
    "onboard file.stl --unit mm --name a --symmetry nan 0 0",
    "onboard file.stl --unit mm --name a --workpieces file",
    "train bracket --loaders 1000",
    "train bracket --batch 1000000000",
    "train bracket --lr inf",
    "evaluate bracket --workers 1000",
    "fit-score bracket --workers 1000",
    "benchmark perception bracket --workers 1000",
    "run bracket --seed=--",
    "run bracket --seed -- 3",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Furnished as for fuzzing, with an STL that holds nothing."""
    made = tmp_path_factory.mktemp("hostile")
    furnish(made)
    (made / "file.stl").write_bytes(b"solid x\n")
    return made


@pytest.mark.parametrize("words", REFUSED)
def test_refused(words: str, folder: Path) -> None:
    before = contents(folder)
    assert check(shlex.split(words), folder) == "refused"
    assert contents(folder) == before


def contents(folder: Path) -> set[Path]:
    """All files, but for those that SQLite makes beside a database that is read."""
    return {path for path in folder.rglob("*") if path.is_file() and not path.name.endswith(("-shm", "-wal"))}


@pytest.mark.parametrize("command", ["run", "gate", "train", "evaluate", "generate", "tune", "sweep", "grasps check"])
def test_a_name_is_named_and_what_was_meant(command: str, tmp_path: Path, monkeypatch, capsys) -> None:
    (tmp_path / "b.json").write_text("{}")
    more = {"gate": ["--baseline", str(tmp_path / "b.json")], "sweep": ["--set", "count=1,2"]}.get(command, [])
    monkeypatch.chdir(tmp_path)
    assert cli.main([*command.split(), "brackt", *more]) == 2
    assert "did you mean bracket?" in capsys.readouterr().err


def test_numbers() -> None:
    assert number(0, 1)("0") == 0.0 and number(0, 1)("1") == 1.0 and number(0, 1, above=True)("1e-9") == 1e-9
    for parse, text in (
        (number(0, 1), "nan"),
        (number(0, 1), "1.1"),
        (number(0, 1, above=True), "0"),
        (number(0, 9), "inf"),
    ):
        with pytest.raises(ValueError, match="expected a number"):
            parse(text)


def test_where_something_can_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert file_to_write(str(tmp_path / "new" / "a.json")) == tmp_path / "new" / "a.json"
    assert file_to_write(str(tmp_path / "file")) == tmp_path / "file"  # as a run before wrote it
    assert folder_to_write(str(tmp_path)) == tmp_path and folder_to_write(str(tmp_path / "a" / "b")).parent.name == "a"
    assert not (tmp_path / "a").exists()
    for parse, path in (
        (file_to_write, ""), (file_to_write, tmp_path), (file_to_write, tmp_path / "file" / "a"),
        (folder_to_write, ""), (folder_to_write, tmp_path / "file"), (folder_to_write, tmp_path / "file" / "a"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match="is not valid"):
            parse(str(path))


def test_what_is_no_regular_file_is_never_replaced(tmp_path: Path) -> None:
    """A named pipe stands for /dev/null, which root would have lost."""
    pipe, link, target = tmp_path / "pipe", tmp_path / "link", tmp_path / "target"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    assert write_whole(pipe, "text") == pipe and os.read(reader, 9) == b"text"
    os.close(reader)
    assert pipe.is_fifo()
    link.symlink_to(target)
    for text in ("new", "again"):
        write_whole(link, text)
        assert link.is_symlink() and target.read_text() == text
    assert {p.name for p in tmp_path.iterdir()} == {"pipe", "link", "target"}


def test_what_may_not_be_written_is_found_before_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pickproof.scenarios.commands.arguments.os.access", lambda path, how: False)
    for parse in (file_to_write, folder_to_write):
        with pytest.raises(ValueError, match="cannot be written"):
            parse(str(tmp_path / "new"))
