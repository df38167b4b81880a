"""Campaigns from Python, as a user calls them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

import pickproof
from pickproof import Campaign, InputError, Scenario, compare, load_scenario
from pickproof.cell.lazy_exports import lazy_exports

ROOMS = ("cell", "perception", "grasping", "robots", "scenarios")
SMALL = ["count=5", "carry.speed_scale=0.9"]


def test_run_gives_the_records_of_the_command(planted, tmp_path: Path) -> None:
    campaign = Campaign.run(load_scenario("bracket", SMALL), episodes=3, seed=4, oracle="perception", out="python")
    words = ["--episodes", "3", "--seed", "4", "--oracle", "perception", "--out", "command"]
    assert planted("run", "bracket", *(w for change in SMALL for w in ("--set", change)), *words) == 0
    command = Campaign.open("command")
    assert campaign.summary["record_hash"] == command.summary["record_hash"]
    assert campaign.summary["scenario_hash"] == command.summary["scenario_hash"]
    assert json.loads(Path("python/summary.json").read_text())["oracle"] == ["perception"]
    assert [e.seed for e in campaign.episodes] == [4, 5, 6]


def test_a_name_and_a_free_folder_are_enough(planted, tmp_path: Path) -> None:
    first, second = (Campaign.run("bracket", episodes=1, oracle=["perception"]) for _ in range(2))
    assert (first.directory, second.directory) == (Path("out/bracket-0"), Path("out/bracket-0-2"))
    more = Campaign.run("bracket", episodes=2, oracle=["perception"], out=first, resume=True)
    assert len(more.episodes) == 2


def test_campaigns_are_compared_as_they_are(planted) -> None:
    def run(rate: float) -> Campaign:
        scenario = load_scenario("bracket", ["count=10", f"carry.speed_scale={rate}"])
        return Campaign.run(scenario, episodes=30, oracle=["perception"], out=f"rate-{rate}")

    good, bad = run(0.95), run(0.7)
    assert compare(good, bad).verdict == "worse"
    assert compare(good, bad) == compare(str(good.directory), bad.directory)


@pytest.mark.parametrize(
    ("arguments", "names"),
    [
        ({"oracle": "perceptoin"}, ["oracle", "perceptoin", "did you mean perception"]),
        ({"episodes": 0}, ["episodes", "0", "1 or more"]),
        ({"workers": 0}, ["workers", "0", "1 or more"]),
        ({"scenario": "brackett"}, ["brackett", "bracket"]),
    ],
)
def test_bad_arguments_are_named(planted, arguments: dict[str, object], names: list[str]) -> None:
    with pytest.raises(InputError) as refused:
        Campaign.run(**({"scenario": "bracket"} | arguments))  # type: ignore[arg-type]
    assert all(name in str(refused.value) for name in names)
    assert not Path("out").exists()


@pytest.mark.parametrize("package", ["pickproof", *(f"pickproof.{room}" for room in ROOMS)])
def test_every_public_name_is_there_and_says_what_it_is(package: str) -> None:
    from importlib import import_module

    module = import_module(package)
    assert module.__all__ and set(dir(module)) == set(module.__all__)
    for name in module.__all__:
        assert getattr(module, name).__doc__, f"{package}.{name} has no docstring"
    with pytest.raises(AttributeError, match="nonesuch"):
        _ = module.nonesuch


def test_a_name_is_imported_when_it_is_asked_for() -> None:
    """The import sets the numeric profile and takes nothing that numpy or torch would be loaded by."""
    code = "import os, sys, pickproof, {}; print(os.environ['OPENBLAS_CORETYPE'], 'numpy' in sys.modules)".format(
        ", ".join(f"pickproof.{room}" for room in ROOMS)
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["Haswell", "False"]
    get, names = lazy_exports("pickproof", {"Scenario": "scenarios.config.scenario"})
    assert get("Scenario") is Scenario is pickproof.Scenario and names() == ["Scenario"]
