"""Proves a pick rate before the cell exists: bin picking simulated from depth image to counted pick.

The rooms `pickproof.cell`, `.perception`, `.grasping`, `.robots` and `.scenarios` are the folders of those names at the
top of the repository; links in this folder give them their import names, in the checkout and in the wheel.

    from pickproof import Campaign
    Campaign.open("out/bracket-0").to_frame().groupby("grasp").success.mean()
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from pickproof.cell.numerics import use_portable_kernels

if TYPE_CHECKING:
    from pickproof.scenarios.campaign.campaign import run_campaign
    from pickproof.scenarios.comparison.compare import Comparison, compare
    from pickproof.scenarios.config.scenario import Scenario, load_scenario
    from pickproof.scenarios.results.campaign_results import Campaign
    from pickproof.scenarios.results.records import AttemptRecord, EpisodeRecord

use_portable_kernels()  # before any module of the project loads numpy

__all__ = [
    "AttemptRecord",
    "Campaign",
    "Comparison",
    "EpisodeRecord",
    "Scenario",
    "compare",
    "load_scenario",
    "run_campaign",
]

_MODULES = {
    "AttemptRecord": "pickproof.scenarios.results.records",
    "Campaign": "pickproof.scenarios.results.campaign_results",
    "Comparison": "pickproof.scenarios.comparison.compare",
    "EpisodeRecord": "pickproof.scenarios.results.records",
    "Scenario": "pickproof.scenarios.config.scenario",
    "compare": "pickproof.scenarios.comparison.compare",
    "load_scenario": "pickproof.scenarios.config.scenario",
    "run_campaign": "pickproof.scenarios.campaign.campaign",
}


def __getattr__(name: str) -> Any:
    """Public names are imported when they are asked for: `pickproof --help` must not wait for numpy."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
