"""Scenarios and their execution: picks, episodes, campaigns, statistics, reports."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pickproof.cell.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from pickproof.scenarios.campaign.library import Campaign
    from pickproof.scenarios.comparison.compare import Comparison, compare
    from pickproof.scenarios.config.scenario import Scenario, list_scenarios, load_scenario
    from pickproof.scenarios.results.records import AttemptRecord, EpisodeRecord, Reason

__all__ = [
    "AttemptRecord",
    "Campaign",
    "Comparison",
    "EpisodeRecord",
    "Reason",
    "Scenario",
    "compare",
    "list_scenarios",
    "load_scenario",
]

_MODULES = {
    "AttemptRecord": "results.records",
    "Campaign": "campaign.library",
    "Comparison": "comparison.compare",
    "EpisodeRecord": "results.records",
    "Reason": "results.records",
    "Scenario": "config.scenario",
    "compare": "comparison.compare",
    "list_scenarios": "config.scenario",
    "load_scenario": "config.scenario",
}

__getattr__, __dir__ = lazy_exports(__name__, _MODULES)
