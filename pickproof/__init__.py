"""Measures the pick rate of a bin picking cell in simulation, from depth image to counted pick.

    from pickproof import Campaign, compare, load_scenario

    if __name__ == "__main__":  # worker processes import this file
        before = Campaign.run("bracket", episodes=8, oracle=["perception"])
        after = Campaign.run(load_scenario("bracket", ["carry.speed_scale=0.8"]), episodes=8, oracle=["perception"])
        print(before.summary["success_rate"], compare(before, after).verdict)

The packages `pickproof.cell`, `.perception`, `.grasping`, `.robots` and `.scenarios` are the folders of those names at
the top of the repository; links in this folder give them their import names, in the checkout and in the wheel. Each of
them exports the classes that a user needs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pickproof.cell.lazy_exports import lazy_exports
from pickproof.cell.numerics import use_portable_kernels
from pickproof.cell.workpiece.folders import register_folder
from pickproof.scenarios.config.shipped import WORKPIECES

if TYPE_CHECKING:
    from pickproof.cell.errors import InputError, PickproofError
    from pickproof.scenarios.campaign.campaign import run_campaign
    from pickproof.scenarios.campaign.library import Campaign
    from pickproof.scenarios.campaign.request import CampaignRequest
    from pickproof.scenarios.comparison.compare import Comparison, compare
    from pickproof.scenarios.config.scenario import Scenario, load_scenario
    from pickproof.scenarios.results.records import AttemptRecord, EpisodeRecord, Reason

use_portable_kernels()  # before any module of the project loads numpy
register_folder(WORKPIECES)  # load_workpiece("bracket") then finds the shipped workpieces

__all__ = [
    "AttemptRecord",
    "Campaign",
    "CampaignRequest",
    "Comparison",
    "EpisodeRecord",
    "InputError",
    "PickproofError",
    "Reason",
    "Scenario",
    "compare",
    "load_scenario",
    "run_campaign",
]

_MODULES = {
    "AttemptRecord": "scenarios.results.records",
    "Campaign": "scenarios.campaign.library",
    "CampaignRequest": "scenarios.campaign.request",
    "Comparison": "scenarios.comparison.compare",
    "EpisodeRecord": "scenarios.results.records",
    "InputError": "cell.errors",
    "PickproofError": "cell.errors",
    "Reason": "scenarios.results.records",
    "Scenario": "scenarios.config.scenario",
    "compare": "scenarios.comparison.compare",
    "load_scenario": "scenarios.config.scenario",
    "run_campaign": "scenarios.campaign.campaign",
}

__getattr__, __dir__ = lazy_exports(__name__, _MODULES)
