import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

pytest_plugins = ["pytester"]
ROOT = Path(__file__).resolve().parents[3]
SUITE = """
    import pytest

    RATE = "carry.speed_scale={rate}"

    @pytest.mark.grasp_rate(episodes={episodes}, {more})
    def test_bracket(grasp_rate, grasp_rate_baseline):
        assert grasp_rate("bracket", "count=5", RATE) >= grasp_rate_baseline
"""
WORSE = """
    def test_worse(grasp_rate, grasp_rate_baseline):
        file = grasp_rate_baseline.path.with_name("test_bracket.json")
        assert grasp_rate("bracket", "count=5", "carry.speed_scale=0.7") >= type(grasp_rate_baseline)(file)
"""
STRICT = """
    @pytest.mark.grasp_rate(strict=True)
    def test_strict(grasp_rate, grasp_rate_baseline):
        file = grasp_rate_baseline.path.with_name("test_bracket.json")
        assert grasp_rate("bracket", "count=5", RATE) >= type(grasp_rate_baseline)(file)
"""
CONFTEST = """
    import sys
    import types
    from tests.scenarios import planted_episode
    from tests.scenarios.in_process import episodes_in_this_process

    sys.modules["pickproof.scenarios.campaign.episode"] = planted_episode
    # a planted episode reads no files, and the real work cell takes seconds to import
    no_cell = types.SimpleNamespace(check_inputs=lambda scenario, oracle: None)
    sys.modules["pickproof.scenarios.picking.workcell"] = no_cell
    episodes_in_this_process()
"""


@pytest.fixture
def suite(pytester, monkeypatch):
    """A user's suite with planted episodes, run in a process of its own."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    pytester.makeconftest(CONFTEST)

    def run(*words, rate=0.95, episodes=160, more="", body=SUITE):
        pytester.makepyfile(test_cell=body.format(rate=rate, episodes=episodes, more=more))
        plugin = ["-p", "no:pickproof", "-p", "pickproof.scenarios.comparison.pytest_plugin", "-p", "no:dash"]
        return pytester.runpytest_subprocess(*plugin, "-p", "no:cacheprovider", *words, timeout=120)

    return run


def test_a_baseline_is_written_then_kept_then_updated(suite, pytester):
    file = pytester.path / "test_cell" / "test_bracket.json"
    first = suite()
    first.assert_outcomes(failed=1)
    first.stdout.fnmatch_lines(["*no baseline: wrote*test_bracket.json*"])
    assert len(json.loads(file.read_text())["rows"]) == 160
    kept = file.read_text()
    worse = suite(body=SUITE + WORSE)
    worse.assert_outcomes(passed=1, failed=1)
    worse.stdout.fnmatch_lines(["*grasp rate of bracket: worse: success of first attempts*"])
    assert file.read_text() == kept
    suite("--grasp-rate-update", "--grasp-rate-episodes", "40", rate=0.7).assert_outcomes(passed=1)
    assert len(json.loads(file.read_text())["rows"]) == 40
    undecided = suite(rate=0.7, body=SUITE + STRICT)
    undecided.assert_outcomes(passed=1, failed=1, warnings=1)
    undecided.stdout.fnmatch_lines(["*GraspRateWarning: undecided*after 40 paired*"])


def test_numbers_and_bad_markers(suite):
    body = """
    import pytest

    @pytest.mark.parametrize(("least", "strict"), [(0.9, False), (0.999, False)])
    def test_number(grasp_rate, least, strict):
        assert grasp_rate("bracket", "count=5", "carry.speed_scale={rate}") >= least

    @pytest.mark.grasp_rate(luck=3)
    def test_marker(grasp_rate):
        pass
    """
    found = suite("--grasp-rate-episodes", "60", rate=0.9, body=body)
    found.assert_outcomes(passed=1, failed=1, errors=1)
    found.stdout.fnmatch_lines(["*grasp rate of bracket: *% of 60> >= 0.999*".replace("% of", "of")])
    found.stdout.fnmatch_lines(["*marker grasp_rate takes episodes, workers*"])


def test_the_plugin_imports_nothing_heavy():
    code = "import sys, pickproof.scenarios.comparison.pytest_plugin; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert not {"numpy", "scipy", "torch", "pydantic", "rich"} & set(done.stdout.split())
