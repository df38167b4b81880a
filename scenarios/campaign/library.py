"""Campaigns from Python: run one, or open its results."""

from __future__ import annotations

import os
from collections.abc import Collection
from pathlib import Path
from typing import Self

from pickproof.cell.errors import InputError, did_you_mean
from pickproof.scenarios.campaign.campaign import run_campaign
from pickproof.scenarios.campaign.request import CampaignRequest
from pickproof.scenarios.config.oracles import ORACLES
from pickproof.scenarios.config.scenario import Scenario, load_scenario, weights_used
from pickproof.scenarios.files.atomic import free_folder
from pickproof.scenarios.results.campaign_results import CampaignResults
from pickproof.scenarios.results.replay_selection import Keep, Which
from pickproof.scenarios.results.summary import write_summary


class Campaign(CampaignResults):
    """A campaign in a folder, from `Campaign.run` or `Campaign.open`."""

    @classmethod
    def run(
        cls,
        scenario: Scenario | str | os.PathLike[str],
        *,
        episodes: int = 10,
        seed: int | None = None,
        workers: int = 1,
        oracle: str | Collection[str] = (),
        out: str | os.PathLike[str] | None = None,
        resume: bool = False,
        keep: Which = "failures",
    ) -> Self:
        """Run episodes of a scenario as `pickproof run` does, with the same records for the same seed.

        Episodes run in new processes that import the main file of the program, so a script must call this under
        `if __name__ == "__main__":`.

        Args:
            scenario: the scenario, its name, or the path of its YAML file.
            episodes: bin fills, at seeds `seed`, `seed` + 1, ...
            seed: of the first episode; None for the scenario's own.
            workers: processes, one episode each at a time.
            oracle: stages that ground truth replaces: `perception`, `grasp`, `motion`.
            out: folder of the results; None for the first free one of `out/SCENARIO-SEED`, `-2`, ...
            resume: continue the campaign in `out`.
            keep: attempts kept for `pickproof replay`: `failures`, `all` or `none`.

        Raises:
            InputError: an argument, a file that the scenario names, or the content of `out` is not valid.
        """
        from pickproof.scenarios.campaign.episode import run_episode  # loads all stages of a pick
        from pickproof.scenarios.picking.workcell import check_inputs

        if not isinstance(scenario, Scenario):
            scenario = load_scenario(os.fspath(scenario))
        stages = _stages(oracle)
        for name, value in (("episodes", episodes), ("workers", workers)):
            if value < 1:
                raise InputError("Campaign.run", name, value, "1 or more")
        first = scenario.seed if seed is None else seed
        folder = free_folder(Path("out") / f"{scenario.name}-{first}") if out is None else Path(out)
        check_inputs(scenario, stages)
        request = CampaignRequest(
            scenario=scenario.model_copy(update={"seed": first}),
            episodes=episodes,
            seed=first,
            out=folder,
            runner=run_episode,
            workers=workers,
            oracle=stages,
            weights_hash=weights_used(scenario, stages),
            command="Campaign.run",
            resume=resume,
            keep=Keep(folder, keep),
        )
        run_campaign(request)
        campaign = cls(folder)
        write_summary(folder, campaign.summary)
        return campaign


def _stages(oracle: str | Collection[str]) -> frozenset[str]:
    stages = frozenset([oracle] if isinstance(oracle, str) else oracle)
    for name in sorted(stages - set(ORACLES)):
        raise InputError("Campaign.run", "oracle", name, f"of {', '.join(ORACLES)}{did_you_mean(name, ORACLES)}")
    return stages
