"""What is run, and what came of it: scenarios, picks, episodes, campaigns, statistics, reports.

from pickproof.scenarios import Campaign
Campaign.open("out/bracket-0").to_frame().groupby("grasp").success.mean()
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pickproof.scenarios.results.campaign_results import Campaign

__all__ = ["Campaign"]


def __getattr__(name: str) -> Any:
    """`Campaign` is imported when it is asked for: `pickproof --help` must not wait for numpy."""
    if name == "Campaign":
        from pickproof.scenarios.results.campaign_results import Campaign

        return Campaign
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
