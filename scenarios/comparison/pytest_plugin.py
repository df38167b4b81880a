"""The pytest plugin: pick rates in a user's own tests.

    def test_bracket(grasp_rate, grasp_rate_baseline):
        assert grasp_rate("bracket") >= grasp_rate_baseline

Only pytest is imported before a test asks for a rate; every pytest run in the environment loads this file.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from pickproof.scenarios.comparison.baseline import BaselineFile
    from pickproof.scenarios.comparison.grasp_rate import GraspRate

MARKER = "grasp_rate"
OPTIONS = ("episodes", "workers", "margin", "alpha", "power", "measure", "strict")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Options of the plugin."""
    group = parser.getgroup("pickproof", "pick rates")
    group.addoption("--grasp-rate-episodes", type=int, metavar="N", help="bins a comparison may use")
    group.addoption("--grasp-rate-workers", type=int, metavar="K", help="processes of a comparison (default 1)")
    group.addoption("--grasp-rate-update", action="store_true", help="write the baselines anew")


def pytest_configure(config: pytest.Config) -> None:
    """Make the marker known."""
    config.addinivalue_line(
        "markers", f"{MARKER}({', '.join(f'{name}=...' for name in OPTIONS)}): how grasp_rate compares in this test"
    )


@pytest.fixture
def grasp_rate_baseline(request: pytest.FixtureRequest) -> BaselineFile:
    """The baseline of this test: TEST_FILE/TEST_NAME.json beside the test file."""
    from pickproof.scenarios.comparison.baseline import BaselineFile

    name = re.sub(r"[^\w-]", "_", request.node.name)
    return BaselineFile(Path(request.path).with_suffix("") / f"{name}.json")


@pytest.fixture
def grasp_rate(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[..., GraspRate]:
    """`grasp_rate(scenario, *overrides, oracle=())`: a rate to compare by >= with a baseline or a number.

    A baseline that is not there is measured and written, and the test fails so that somebody looks at it.
    """
    from pickproof.scenarios.comparison.grasp_rate import GraspRate
    from pickproof.scenarios.config.scenario import load_scenario
    from pickproof.scenarios.picking.workcell import check_inputs
    from pickproof.scenarios.statistics.sequential_test import Rule

    options = _options(request)
    rule = Rule(**{key: options.pop(key) for key in ("margin", "alpha", "power") if key in options})
    update: bool = request.config.getoption("--grasp-rate-update")
    made = 0

    class Measured(GraspRate):
        def __ge__(self, other: object) -> bool:
            if hasattr(other, "path") and (update or not other.path.is_file()):
                self.write(other)  # type: ignore[arg-type]
                if not update:
                    pytest.fail(f"no baseline: wrote {other.path}; look at it, commit it and run again", pytrace=False)
                return True
            return super().__ge__(other)

    def measure(name: str, *overrides: str, oracle: Sequence[str] = ()) -> GraspRate:
        nonlocal made
        made += 1
        scenario = load_scenario(name, overrides)
        check_inputs(scenario, frozenset(oracle))
        return Measured(scenario, tmp_path / f"rate-{made}", oracle=frozenset(oracle), rule=rule, **options)

    return measure


def _options(request: pytest.FixtureRequest) -> dict[str, Any]:
    """The marker's values, those of the command line before them."""
    options: dict[str, Any] = {}
    for marker in reversed(list(request.node.iter_markers(MARKER))):
        unknown = set(marker.kwargs) - set(OPTIONS)
        if marker.args or unknown:
            raise pytest.UsageError(f"marker {MARKER} takes {', '.join(OPTIONS)} by name, not {marker}")
        options |= marker.kwargs
    for name in ("episodes", "workers"):
        value = request.config.getoption(f"--grasp-rate-{name}")
        if value is not None:
            if value < 1:
                raise pytest.UsageError(f"--grasp-rate-{name}: {value} is not valid; expected 1 or more")
            options[name] = value
    return options
