"""Attempts an hour of a core, where their time goes, what engine and workers cost (`pickproof benchmark campaign`).

Times are processor time of the processes themselves, so other work on the machine disturbs them little (caches and
memory are shared all the same). The speed of two workers is taken by the clock, which only a quiet machine can give;
`elsewhere` says how many processors were busy with other things meanwhile.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from pickproof.scenarios.campaign.campaign import run_campaign
from pickproof.scenarios.campaign.episode import run_episode
from pickproof.scenarios.campaign.job import Job
from pickproof.scenarios.campaign.request import CampaignRequest
from pickproof.scenarios.config.scenario import Scenario, weights_used
from pickproof.scenarios.files.atomic import write_json
from pickproof.scenarios.results.broken_campaign import check_ran
from pickproof.scenarios.results.records import AttemptRecord, EpisodeRecord
from pickproof.scenarios.results.store import Store

ORACLE = frozenset({"perception"})
STAGES = (
    ("fill", "pickproof.scenarios.picking.workcell.fill_bin"),
    ("camera", "pickproof.scenarios.picking.workcell.render"),
    ("sensor", "pickproof.scenarios.picking.workcell.measure"),
    ("choose", "pickproof.scenarios.picking.pick.choose"),
    ("plan", "pickproof.scenarios.picking.pick.decide"),
    ("motion", "pickproof.scenarios.picking.pick.execute_pick"),
)
"""Parts of an attempt, and the functions whose time they are."""


@dataclass(frozen=True)
class Timed:
    """An episode; times in [s], by the clock, of the worker's processor, and of that for handing attempts on."""

    seed: int
    attempts: int
    begun: float
    ended: float
    processor_s: float
    handing_s: float


def timed_episode(folder: Path, job: Job, on_attempt: Callable[[AttemptRecord], None]) -> EpisodeRecord:
    """`run_episode`, with its times in FOLDER/SEED.json; the first of a process is preceded by what loads lazily."""
    handing, tried = 0.0, 0

    def hand_on(record: AttemptRecord) -> None:
        nonlocal handing, tried
        tried += record.moved
        start = time.process_time()
        on_attempt(record)
        handing += time.process_time() - start

    begun, start = time.time(), time.process_time()
    end = run_episode(job, hand_on)
    spent = time.process_time() - start
    timed = Timed(job.seed, tried, begun, time.time(), spent, handing)
    write_json(folder / f"{job.seed}.json", vars(timed))
    return end


def measure(scenario: Scenario, episodes: int, folder: Path) -> dict[str, Any]:
    """All figures; as `pickproof benchmark campaign --json` writes them."""
    busy, mine = _processors(), os.times()
    split = split_of(scenario)
    one, driver_s = _campaign(scenario, episodes, 1, ORACLE, folder / "one", {})
    lasts = {t.seed: t.ended - t.begun for t in one}
    two, _ = _campaign(scenario, episodes, 2, ORACLE, folder / "two", lasts)
    ps6d, _ = _campaign(scenario, 1, 1, frozenset(), folder / "ps6d", {})
    bare_s = sum(t.processor_s - t.handing_s for t in one)
    span = max(t.ended for t in two) - min(t.begun for t in two)
    elapsed = os.times().elapsed - mine.elapsed
    return {
        "picks_per_hour_core": {"oracle": _hourly(one), "ps6d": _hourly(ps6d)},
        "two_worker_speedup": sum(lasts.values()) / span,
        "two_worker_speedup_processor": 2 * sum(t.processor_s for t in one) / sum(t.processor_s for t in two),
        "engine_overhead": (driver_s + sum(t.handing_s for t in one)) / bare_s,
        "split_s": split,
        "attempts": {"one": _attempts(one), "two": _attempts(two), "ps6d": _attempts(ps6d)},
        "elsewhere": (_processors() - busy - (_own(os.times()) - _own(mine))) / elapsed,
    }


def split_of(scenario: Scenario) -> dict[str, float]:
    """Processor time [s] of an attempt by stage, of one oracle episode; the bin's filling is spread over its attempts.

    `motion` lasts until all lie still again; `steps` are the physics engine's own, part of `fill` and `motion`.
    """
    spent: dict[str, float] = {}
    tried: list[AttemptRecord] = []
    with _stages(spent):
        start = time.process_time()
        run_episode(Job(scenario, scenario.seed, ORACLE), tried.append)
        total = time.process_time() - start
    n = max(1, sum(a.moved for a in tried))
    steps = spent.pop("steps")
    spent["other"] = total - sum(spent.values())
    return {name: seconds / n for name, seconds in spent.items()} | {"total": total / n, "steps": steps / n}


@contextmanager
def _stages(spent: dict[str, float]) -> Iterator[None]:
    """Adds up the processor time of STAGES in `spent`, and that of the engine's steps."""

    def timed(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            start = time.process_time()
            try:
                return function(*args, **kwargs)
            finally:
                spent[name] = spent.get(name, 0.0) + time.process_time() - start

        return call

    with ExitStack() as stack:
        for name, place in (*STAGES, ("steps", "pickproof.cell.physics.world.World.step")):
            owner, _, attribute = place.rpartition(".")
            target = resolve_name(owner)
            original = getattr(target, attribute)
            setattr(target, attribute, timed(name, original))
            stack.callback(setattr, target, attribute, original)
        yield


def _campaign(
    scenario: Scenario, episodes: int, workers: int, oracle: frozenset[str], folder: Path, expected_s: dict[int, float]
) -> tuple[list[Timed], float]:
    """Times of the episodes, and processor time [s] of the driver while they ran."""
    start = time.process_time()
    request = CampaignRequest(
        scenario=scenario,
        episodes=episodes,
        seed=scenario.seed,
        workers=workers,
        oracle=oracle,
        out=folder / "out",
        runner=partial(timed_episode, folder),
        weights_hash=weights_used(scenario, oracle),
        pictures=False,
        expected_s=expected_s,
    )
    run_campaign(request)
    spent = time.process_time() - start
    check_ran(folder / "out")
    with Store.read(folder / "out") as store:
        seeds = [e.seed for e in store.episodes()]
    return [Timed(**json.loads((folder / f"{s}.json").read_text(encoding="utf-8"))) for s in seeds], spent


def _attempts(timed: list[Timed]) -> int:
    return sum(t.attempts for t in timed)


def _hourly(timed: list[Timed]) -> float:
    return 3600 * _attempts(timed) / sum(t.processor_s for t in timed)


def _own(times: os.times_result) -> float:
    return times.user + times.system + times.children_user + times.children_system


def _processors() -> float:
    """Processor time [s] that all processes of the machine have used; 0 where the system does not tell."""
    try:
        fields = Path("/proc/stat").read_text(encoding="ascii").splitlines()[0].split()
    except OSError:
        return 0.0
    user, nice, system = (int(f) for f in fields[1:4])
    return (user + nice + system) / os.sysconf("SC_CLK_TCK")
