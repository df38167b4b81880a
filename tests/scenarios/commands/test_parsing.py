"""Where options may stand, which folders count, and what is said of a wrong word."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from pickproof.cell.errors import InputError
from pickproof.scenarios.commands import cli
from pickproof.scenarios.commands.arguments import search_folders


def refusal(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The one line with which these words are refused."""
    assert cli.main(words) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("pickproof: error: ") and err.count("\n") == 1
    return err


@pytest.mark.parametrize(
    "words",
    [
        ["--workpieces", "{a}", "grasps", "export", "bracket"],
        ["grasps", "--workpieces", "{a}", "export", "bracket"],
        ["grasps", "export", "--workpieces", "{a}", "bracket"],
        ["grasps", "export", "bracket", "--workpieces={a}"],
        ["--workpieces={a}", "benchmark", "gate"],
        ["benchmark", "--workpieces", "{a}", "gate"],
        ["benchmark", "gate", "--workpieces", "{a}", "--seed", "3"],
    ],
)
def test_folders_stand_anywhere(words: list[str], tmp_path: Path) -> None:
    parser = cli._parser()
    args = parser.parse_args([word.format(a=tmp_path) for word in words])
    assert parser.folders == [str(tmp_path)] and callable(args.command)


def test_folders_keep_their_order_at_every_depth(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = ["a", "b", "c", "d"]
    for name in names:
        (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PICKPROOF_WORKPIECES", "/before")
    words = ["--workpieces", "a", "grasps", "--workpieces=b", "check", "--workpieces", "c", "x", "--workpieces", "d"]
    parser = cli._parser()
    parser.parse_args(words)
    assert search_folders(parser.folders) == os.pathsep.join([*(str(tmp_path / n) for n in names), "/before"])


@pytest.mark.parametrize("at", [0, 1, 9])
def test_onboard_makes_its_folder_wherever_it_is_named(at: int, tmp_path: Path, capsys) -> None:
    """The mesh is missing, which is found only after the folder was made."""
    words = ["onboard", "none.stl", "--unit", "mm", "--name", "a", "--yes"]
    words[at:at] = ["--workpieces", str(tmp_path / "new")]
    assert "none.stl" in refusal(words, capsys)
    assert (tmp_path / "new").is_dir()


def test_only_the_folder_that_is_written_may_be_new(tmp_path: Path) -> None:
    new, old = str(tmp_path / "new"), str(tmp_path)
    assert search_folders([new, old], makes_first=True) == os.pathsep.join([new, old])
    (tmp_path / "file").touch()
    for given, makes in (([new], False), ([old, new], True), ([str(tmp_path / "file")], True), ([""], True)):
        with pytest.raises(InputError, match="--workpieces"):
            search_folders(given, makes)


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["--workpiece", "DIR", "gate"], ["--workpiece;", "did you mean --workpieces?"]),
        (["--workp=DIR", "list"], ["unknown option --workp;"]),
        (["benchmark", "--json", "gate"], ["unknown option --json", "follow its name"]),
        (["--episodes", "3", "run", "bracket"], ["unknown option --episodes", "follow its name"]),
        (["-x", "DIR", "list"], ["unknown option -x"]),
        (["run", "bracket", "--epsiodes", "3"], ["--epsiodes", "did you mean --episodes?"]),
        (["run", "bracket", "--epi", "3"], ["unknown option --epi"]),
        (["run", "bracket", "--set", "--episodes", "3"], ["--set", "one argument"]),
        (["run", "bracket", "bunny"], ["bunny"]),
        (["evaluat"], ["did you mean evaluate?"]),
        (["benchmark", "preception"], ["did you mean perception?"]),
        (["benchmark"], ["SUBJECT"]),
        (["grasps"], ["COMMAND"]),
        (["grasps", "chekc", "bracket"], ["did you mean check?"]),
        (["run", "braket"], ["braket", "did you mean bracket?"]),
        (["grasps", "export", "gear_shft"], ["did you mean gear_shaft?"]),
        (["run", "bracket", "--set", "gripper=jaw_v2"], ["jaw_v2", "did you mean jaw_v1?"]),
        (["run", "a\nb"], ["a\\nb"]),
        (["", "list"], ["''"]),
        (["list", "--workpieces"], ["--workpieces"]),
        (["list", "--workpieces", ""], ["--workpieces"]),
    ],
)
def test_wrong_words_are_named(words: list[str], names: list[str], capsys) -> None:
    err = refusal(words, capsys)
    assert all(name in err for name in names), err


@pytest.mark.parametrize("subject", ["perception", "motion", "campaign", "gate"])
def test_each_benchmark_has_arguments_of_its_own(subject: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["benchmark", subject, "--help"]) == 0
    own = {"perception": "--methods", "motion": "--picks", "campaign": "--episodes", "gate": "--campaigns"}
    out = capsys.readouterr().out
    assert [name for name, option in own.items() if option in out] == [subject]


def test_every_command_has_a_help(capsys: pytest.CaptureFixture[str]) -> None:
    for name in (*cli._COMMANDS, "list", "benchmark", "grasps edit", "grasps sample"):
        assert cli.main([*name.split(), "--help"]) == 0
        out, err = capsys.readouterr()
        assert f"usage: pickproof {name}" in out and err == ""
