"""One import name: the wheel puts everything under `pickproof`, and stands beside modules called cell or scenarios."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("cell", "perception", "grasping", "robots", "scenarios")
SUITE = """
import cell
import scenarios


def test_own_modules_are_found():
    assert cell.MINE and scenarios.MINE


def test_the_plugin_is_that_of_the_wheel(request, grasp_rate):
    plugin = request.config.pluginmanager.get_plugin("pickproof")
    assert plugin.__name__ == "pickproof.scenarios.comparison.pytest_plugin"
    assert plugin.__file__.startswith({installed!r})


def test_the_library_does_not_take_them():
    from pickproof import Scenario, load_scenario
    from pickproof.cell.grippers.registry import load_gripper

    scenario = load_scenario("bracket")
    assert isinstance(scenario, Scenario)
    assert load_gripper(scenario.gripper).mass > 0
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("hatchling", reason="builds the wheel")
    folder = tmp_path_factory.mktemp("wheel")
    words = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(words, cwd=ROOT, check=True, capture_output=True)
    return next(folder.glob("*.whl"))


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that holds the wheel's content as pip installs it."""
    folder = tmp_path_factory.mktemp("installed")
    words = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", str(folder)]
    subprocess.run([*words, str(wheel)], check=True, capture_output=True)
    return folder


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A user's project with modules of the names that the folders have."""
    (tmp_path / "cell.py").write_text("MINE = True\n")
    (tmp_path / "scenarios").mkdir()
    (tmp_path / "scenarios" / "__init__.py").write_text("MINE = True\n")
    return tmp_path


def run(words: list[str], installed: Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    clean = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    environment = clean | {"PYTHONPATH": str(installed)}
    return subprocess.run(
        [sys.executable, *words], cwd=cwd, env=environment, capture_output=True, text=True, timeout=300
    )


def test_the_wheel_holds_every_file_of_the_rooms_under_one_name(wheel: Path) -> None:
    with ZipFile(wheel) as archive:
        names = set(archive.namelist())
    assert {name.split("/")[0] for name in names if ".dist-info" not in name} == {"pickproof"}
    listed = subprocess.run(["git", "ls-files", *ROOMS], cwd=ROOT, capture_output=True, text=True, check=False)
    files = listed.stdout.split() or [str(p.relative_to(ROOT)) for room in ROOMS for p in (ROOT / room).rglob("*.py")]
    there = [file for file in files if (ROOT / file).is_file()]
    assert not [file for file in there if f"pickproof/{file}" not in names]
    assert {"pickproof/py.typed", "pickproof/__init__.py"} <= names


def test_a_suite_of_a_project_with_modules_of_those_names(installed: Path, project: Path) -> None:
    (project / "test_own.py").write_text(SUITE.format(installed=str(installed)))
    done = run(["-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:dash"], installed, project)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "3 passed" in done.stdout


def test_the_command_runs_beside_them(installed: Path, project: Path) -> None:
    done = run(["-m", "pickproof", "list"], installed, project)
    assert done.returncode == 0, done.stderr
    assert "bracket" in done.stdout
    script = run([str(installed / "bin" / "pickproof"), "--version"], installed, project)
    assert "pickproof " in script.stdout + script.stderr


def test_a_campaign_runs_beside_them(installed: Path, project: Path) -> None:
    """From the installed files alone, worker processes included."""
    words = ["run", "bracket", "--episodes", "1", "--set", "count=1", "--set", "stop.attempt_limit=1", "--no-pictures"]
    words += ["--oracle", "perception", "--oracle", "motion", "--out", "out"]
    done = run(["-m", "pickproof", *words], installed, project)
    assert done.returncode == 0, done.stderr
    assert json.loads((project / "out" / "summary.json").read_text())["attempts"] == 1


def test_the_import_is_light_and_knows_its_public_names(installed: Path, project: Path) -> None:
    code = "import sys, pickproof; print(pickproof.__file__, *sys.modules)"
    file, *modules = run(["-c", code], installed, project).stdout.split()
    assert file.startswith(str(installed))
    assert not {"numpy", "torch", "pydantic", "rich"} & set(modules)
    code = "import pickproof; print(all(getattr(pickproof, name) for name in pickproof.__all__))"
    assert run(["-c", code], installed, project).stdout.split()[-1] == "True"
