"""Where options may stand, which folders count, and what is said of a wrong word."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from typing import Any, get_args

import pytest
from cyclopts import App

from pickproof.cell.child_process import FOLDERS
from pickproof.cell.errors import InputError
from pickproof.cell.mesh.check import UNITS
from pickproof.cell.workpiece.workpiece import UNITS as SMALL_UNITS
from pickproof.perception.benchmark.methods import ABLATION_WORKPIECES, METHODS
from pickproof.perception.ps6d.variants import VARIANTS
from pickproof.perception.training.trainer import TrainConfig
from pickproof.scenarios.commands import cli
from pickproof.scenarios.commands.arguments import search_folders
from pickproof.scenarios.commands.benchmark import perception as benchmark_perception
from pickproof.scenarios.commands.decide import gate
from pickproof.scenarios.commands.perception import train
from pickproof.scenarios.commands.registry import build_app, typed_commands
from pickproof.scenarios.commands.workpiece import onboard
from pickproof.scenarios.comparison.paired import MEASURES
from pickproof.scenarios.onboarding.part import MATERIALS
from pickproof.scenarios.reporting.explain import ESTIMATES_SHOWN
from pickproof.scenarios.statistics.sequential_test import Rule


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
def test_folders_stand_anywhere(words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert searched([word.format(a=tmp_path) for word in words], monkeypatch) == str(tmp_path)


def searched(words: list[str], monkeypatch: pytest.MonkeyPatch) -> str:
    """PICKPROOF_WORKPIECES as a command sees it."""
    seen: list[str] = []

    def command(*args: object, **kwargs: object) -> int:
        seen.append(os.environ.get(FOLDERS, ""))
        return 0

    parse_args = App.parse_args

    def parsed(app: App, *args: Any, **kwargs: Any) -> Any:
        """As the library parses it, with a command that notes what it sees in place of the real one."""
        found, bound, ignored = parse_args(app, *args, **kwargs)
        return found if found.__name__ == "launch" else command, bound, ignored

    with monkeypatch.context() as patch:
        patch.setattr(App, "parse_args", parsed)
        assert cli.main(words) == 0
    return seen[0]


def test_folders_keep_their_order_at_every_depth(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = ["a", "b", "c", "d"]
    for name in names:
        (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(FOLDERS, "/before")
    words = ["--workpieces", "a", "grasps", "--workpieces=b", "check", "--workpieces", "c", "x", "--workpieces", "d"]
    assert searched(words, monkeypatch) == os.pathsep.join([*(str(tmp_path / n) for n in names), "/before"])


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
        (["benchmark"], ["COMMAND", "perception"]),
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
    for name in [*typed_commands(), "grasps", "benchmark"]:
        assert cli.main([*name.split(), "--help"]) == 0
        out, err = capsys.readouterr()
        assert f"Usage: pickproof {name}" in out and err == ""


OLD = (
    "run bracket --set count=15 --set sensor.axial_sigma=3e-4 --oracle perception --oracle motion --workers 2 "
    "--episodes 10 --seed 3 --out o --resume --ray local --no-pictures --keep all --json",
    "report d --out f.html",
    "explain d --attempt 4 --all --json",
    "replay d --attempt 0 --port 8081 --record film.gif",
    "index a b c --out f.html",
    "export d --parquet p.parquet",
    "export-program d --attempt 4 --name N --output 7 --out f.ls",
    "compare a b --json f.json",
    "baseline bracket --baseline b.json --episodes 5 --seed 1 --whole --out o --resume --set a=1 --oracle grasp",
    "gate bracket --baseline b.json --measure success --margin 0.1 --alpha 0.1 --power 0.8 --max-episodes 3 --out o "
    "--resume --json g.json --junit g.xml --workers 2",
    "attribute bracket --episodes 6 --seed 1 --out o --resume --json --set a=1",
    "sweep bracket --set count=10:30:10 --episodes 2 --seed 1 --out o --workers 2",
    "tune bracket --set a=1:2 --grasps all --shift 1 --turn 2 --errors e.json --generations 1 --rounds 1 --episodes 4 "
    "--block 2 --holdout 3 --budget 2h --seed 1 --ray auto --out o --resume --accept --workers 2",
    "onboard part.stl --unit mm --name part --material pom --symmetry 0 0 120 --yes --replace",
    "grasps import w f.yaml --gripper g --out o.yaml --tool 0 0 0.1034 0 -90 90",
    "grasps export w --gripper g --out o.yaml --tool 0 0 0.1034 0 0 90",
    "grasps check w --gripper g --json",
    "grasps sample w --gripper g --count 3 --seed 1 --least 0.2 --out o.yaml",
    "grasps edit w --gripper g --grasps f.yaml --port 8081",
    "grasps robustness w --gripper g --grasps a,b --table t.yaml --errors e.json --workers 2 --out o",
    "generate w --scenes 3 --seed 1 --count 1:4 --workers 2 --out o --export bop d --views 2 --split val --sensor tof",
    "generate w --no-noise",
    "train w --minutes 1 --clouds 3 --heaps 2 --data d --batch 2 --reuse 1 --lr 1e-3 --loaders 2 --seed 1 "
    "--variant plain --init w --resume --out o",
    "train w --bop d --split train_pbr --bop-sensor photoneo --obj 3",
    "evaluate w --frames 2 --seed 1 --weights w.safetensors --sensor stereo --workers 2 --json --out o",
    "evaluate w --bop d --bop-results r.csv",
    "fit-score w --frames 3 --weights f --workers 2 --out s.json",
    "perceive w i.png --camera c.json --depth-scale 0.1 --camera-id 3 --depth-is range --camera-pose p.txt "
    "--sigma 1e-4 --roi -1 -1 0 1 1 1 --weights f --seed 1 --json --out o",
    "perceive w i.npy --fx 1 --fy 1 --cx 1 --cy 1 --unit mm --bin b.yaml",
    "benchmark perception a b --frames 3 --ppf-frames 2 --methods ps6d ps6d_refined --ablations --stages "
    "--weights-folder a --variants-folder b --workers 2 --out o --resume --json",
    "benchmark motion bracket --picks 3 --json f.json",
    "benchmark campaign bracket --episodes 2 --set count=15 --json f.json",
    "benchmark gate --campaigns 10 --seed 1 --json f.json",
    "list",
)
"""Every option that argparse read before, spelled as it was."""


@pytest.mark.parametrize("words", OLD)
def test_old_spellings_are_read(words: str) -> None:
    command, bound, unknown = build_app().parse_args(words.split(), exit_on_error=False, print_error=False)
    assert callable(command) and not unknown
    given = [w for w in words.split() if w.startswith("--")]
    options = bound.arguments.get("options")
    for option in given:
        field = option.lstrip("-").replace("-", "_")
        value = getattr(options, field) if options is not None else bound.arguments[field]
        assert value not in (None, False, (), ""), option


def test_the_last_of_a_repeated_option_counts() -> None:
    _, bound, _ = build_app().parse_args(["run", "bracket", "--seed", "1", "--seed", "2"], exit_on_error=False)
    assert bound.arguments["options"].seed == 2


def test_choices_and_defaults_are_those_of_the_rooms() -> None:
    """The command line states them again, as importing the rooms takes seconds."""
    assert get_args(gate.Measure) == MEASURES
    assert get_args(onboard.Unit) == tuple(UNITS) and get_args(onboard.Material) == tuple(MATERIALS)
    assert get_args(benchmark_perception.Method) == benchmark_perception.METHODS == METHODS
    assert set(SMALL_UNITS) == {"m", "cm", "mm"} and ESTIMATES_SHOWN
    assert ABLATION_WORKPIECES == ("ps6d_23", "ps6d_24", "candlestick")
    options, config, rule = train.TrainOptions(), TrainConfig(), Rule()
    for name in ("minutes", "clouds", "heaps", "batch", "reuse", "loaders", "seed", "init"):
        assert getattr(options, name) == getattr(config, name)
    assert options.lr == config.learning_rate and options.variant in VARIANTS
    judged = gate.GateOptions(baseline=Path("b"))
    assert (judged.margin, judged.alpha, judged.power) == (rule.margin, rule.alpha, rule.power)


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("pickproof ", {"run", "grasps", "benchmark", "fit-score"}),
        ("pickproof gr", {"grasps"}),
        ("pickproof grasps ", {"edit", "robustness"}),
        ("pickproof run bracket --no", {"--no-pictures"}),
        ("pickproof run bracket --oracle ", {"perception", "grasp", "motion"}),
    ],
)
def test_bash_completes(line: str, offered: set[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["completion", "bash"]) == 0
    (tmp_path / "script").write_text(capsys.readouterr().out)
    ask = (
        f"source {tmp_path / 'script'}; COMP_LINE={line!r}; COMP_POINT=${{#COMP_LINE}}; "
        f"read -ra COMP_WORDS <<< {line!r}; "
        f"[[ {line!r} == *' ' ]] && COMP_WORDS+=(''); COMP_CWORD=$((${{#COMP_WORDS[@]}} - 1)); "
        "f=$(complete -p pickproof | sed -E 's/.*-F ([^ ]+).*/\\1/'); $f; printf '%s\\n' \"${COMPREPLY[@]}\""
    )
    done = subprocess.run(["bash", "-c", ask], capture_output=True, text=True, timeout=60)
    assert offered <= {word.strip() for word in done.stdout.splitlines()}, done


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_have_a_script(shell: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert all(
        word in script
        for word in ("pickproof", "export-program", "robustness", "--no-pictures" if shell == "zsh" else "no-pictures")
    )
    (tmp_path / "script").write_text(script)
    if program := shutil.which(shell):
        subprocess.run([program, "-n", str(tmp_path / "script")], check=True, timeout=60)
