"""A user's workpieces and scenarios anywhere: --workpieces DIR and PICKPROOF_WORKPIECES, before the shipped ones."""

import os
import shutil
import subprocess
import sys

import pytest

from pickproof.cell.child_process import FOLDERS
from pickproof.cell.workpiece.workpiece import list_workpieces, load_workpiece
from pickproof.scenarios.commands.cli import main
from pickproof.scenarios.config.scenario import SHIPPED as SCENARIOS
from pickproof.scenarios.config.scenario import load_scenario
from pickproof.scenarios.config.shipped import WORKPIECES

pytestmark = pytest.mark.slow


@pytest.fixture
def mine(tmp_path):
    """A folder with a copy of the bracket, named clip, and its scenario of 7."""
    folder = tmp_path / "parts" / "clip"
    shutil.copytree(WORKPIECES / "bracket", folder, ignore=shutil.ignore_patterns("variants"))
    for source, name in ((folder / "workpiece.yaml", "workpiece.yaml"), (SCENARIOS / "bracket.yaml", "scenario.yaml")):
        text = (
            source.read_text().replace("name: bracket", "name: clip").replace("workpiece: bracket", "workpiece: clip")
        )
        (folder / name).write_text(text.replace("count: 30", "count: 7"))
    return tmp_path / "parts"


@pytest.mark.parametrize("at", [0, 1])
@pytest.mark.parametrize("form", ["two words", "equals"])
def test_any_command_takes_the_folder_anywhere(mine, at, form, capsys):
    option = [f"--workpieces={mine}"] if form == "equals" else ["--workpieces", str(mine)]
    words = ["list"]
    words[at:at] = option
    assert main(words) == 0
    out = capsys.readouterr().out
    assert "7 x clip" in out and out.count("  clip") == 2 and "  bracket" in out
    assert FOLDERS not in os.environ  # nothing is left behind for the next command


def test_own_names_come_before_shipped_ones(mine, monkeypatch):
    (mine / "clip").rename(mine / "bracket")
    yaml = mine / "bracket" / "scenario.yaml"
    yaml.write_text(yaml.read_text().replace("workpiece: clip", "workpiece: bracket"))
    monkeypatch.setenv(FOLDERS, f"{mine.parent / 'nothing'}{os.pathsep}{mine}")
    assert load_workpiece("bracket").folder == mine / "bracket"
    assert load_scenario("bracket").count == 7 and load_scenario("bunny").workpiece == "bunny"
    assert set(list_workpieces()) > {"bracket", "bunny"}


def test_commands_read_an_own_part(mine, capsys):
    assert main(["grasps", "export", "clip", "--workpieces", str(mine)]) == 0
    assert "isaac_grasp" in capsys.readouterr().out
    assert main(["grasps", "export", "clip"]) == 2
    assert "'clip' is not valid" in capsys.readouterr().err


def test_a_missing_folder_is_one_line(capsys):
    assert main(["list", "--workpieces", "/no/such"]) == 2
    err = capsys.readouterr().err
    assert "--workpieces" in err and "existing folder" in err and err.count("\n") == 1


def test_workers_see_it(mine, tmp_path):
    command = "from pickproof.scenarios.commands.cli import main; import sys; sys.exit(main())"
    words = ["run", "clip", "--episodes", "1", "--set", "count=1", "--set", "stop.attempt_limit=1"]
    words += ["--oracle", "perception", "--oracle", "motion", "--no-pictures", "--workpieces", str(mine)]
    done = subprocess.run([sys.executable, "-c", command, *words], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "clip-0" / "summary.json").is_file()
