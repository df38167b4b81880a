"""Every example runs, with few workpieces and episodes."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Callable
from pathlib import Path

import pytest

pytest_plugins = ["pytester"]
EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
FEW = ["--episodes", "1", "--count", "2"]
pytestmark = pytest.mark.slow


@pytest.fixture
def example(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """An example's main, called in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PICKPROOF_WORKPIECES", "")  # own_part.py sets it

    def run(name: str, *words: str) -> int:
        spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return int(module.main(words))

    return run


def test_run_campaign(example: Callable[..., int], capsys: pytest.CaptureFixture[str]) -> None:
    assert example("run_campaign", *FEW) == 0
    shown = capsys.readouterr().out
    assert "speed 1: 2 picks" in shown and "changed: carry.speed_scale; pick success: no evidence" in shown


def test_tune_field(example: Callable[..., int], capsys: pytest.CaptureFixture[str]) -> None:
    assert example("tune_field", *FEW, "--values", "0.0", "1.0") == 0
    assert re.search(r"weight_height = (0|1)\.0 on unseen bins: pick success", capsys.readouterr().out)


def test_perceive_image(example: Callable[..., int], capsys: pytest.CaptureFixture[str]) -> None:
    assert example("perceive_image", "--count", "3") == 0
    lines = capsys.readouterr().out.splitlines()
    assert 1 <= len(lines) <= 3 and all(" m   score " in line for line in lines)


def test_own_part(example: Callable[..., int], monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.setattr("pickproof.scenarios.onboarding.part.PROPOSED", 4)  # a few grasps are enough here
    monkeypatch.setattr("pickproof.scenarios.onboarding.part.ENOUGH", 3)
    assert example("own_part", *FEW) == 0
    assert "pick success" in capsys.readouterr().out
    assert Path("out/parts/campaign/summary.json").is_file()


CONFTEST = """
import sys, types
from tests.scenarios import planted_episode
from tests.scenarios.in_process import episodes_in_this_process

sys.modules["pickproof.scenarios.campaign.episode"] = planted_episode
no_cell = types.SimpleNamespace(check_inputs=lambda scenario, oracle: None)
sys.modules["pickproof.scenarios.picking.workcell"] = no_cell
episodes_in_this_process()
"""


def test_the_suite_writes_its_baseline_and_then_passes(pytester: pytest.Pytester, monkeypatch) -> None:
    """With planted episodes: 40 bins of physics would take minutes."""
    monkeypatch.setenv("PYTHONPATH", str(EXAMPLES.parent))
    pytester.makeconftest(CONFTEST)
    pytester.makepyfile(test_pick_rate=(EXAMPLES / "test_pick_rate.py").read_text(encoding="utf-8"))
    words = ["-p", "no:pickproof", "-p", "pickproof.scenarios.comparison.pytest_plugin", "-p", "no:dash"]
    for outcome in ("failed", "passed"):
        found = pytester.runpytest_subprocess(*words, "-p", "no:cacheprovider", timeout=300)
        found.assert_outcomes(**{outcome: 1})
