"""Is the search of `pickproof tune` worth its code? `python -m tests.benchmarks.tuning_search --help`.

Grasp points are spoiled as in `tests.benchmarks.tuning`. Each is searched with the same number of physics trials, in
generations of the same size, by the search of `pickproof tune` and by samplers of Optuna alone. A search is judged by
the mean share of unseen pose errors under which its best grasp point holds, after a quarter, half and all trials.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import optuna
from optuna.samplers import BaseSampler, CmaEsSampler, GPSampler, TPESampler

from pickproof.cell.frames import Array
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.grasping.grasp_points import GraspPoint, read_table
from pickproof.scenarios.config.scenario import load_scenario
from pickproof.scenarios.tuning.grasp_objective import GraspTask, draw_errors, try_point
from pickproof.scenarios.tuning.grasp_space import Reach, distance, grasp_parameters, moved
from pickproof.scenarios.tuning.grasp_stage import PER_GRASP
from pickproof.scenarios.tuning.optimizer import Parameter, Search, Told, Values, open_journal
from tests.benchmarks.tuning import spoiled

Evaluate = Callable[[list[Values]], list[Told]]


@dataclass(frozen=True)
class Outcome:
    """One grasp point searched once: best value, and share held under unseen errors, at each share of the budget."""

    workpiece: str
    grasp: str
    seed: int
    search: str
    values: list[float]
    held: list[float]


def pickproof_search(parameters: list[Parameter], seed: int, trials: int, evaluate: Evaluate) -> Iterator[float]:
    """The search of `pickproof tune`; yields nothing, evaluates generation by generation."""
    with tempfile.TemporaryDirectory() as folder:
        search = Search(open_journal(Path(folder)), "grasp", parameters, seed)
        while len(search.trials) < trials:
            search.run_generation(PER_GRASP, evaluate)
            yield len(search.trials)


def sampler_search(
    make: Callable[[list[Parameter], int], BaseSampler],
) -> Callable[[list[Parameter], int, int, Evaluate], Iterator[float]]:
    """A search by a sampler of Optuna alone: the start is its first trial, the rest is asked of the sampler."""

    def run(parameters: list[Parameter], seed: int, trials: int, evaluate: Evaluate) -> Iterator[float]:
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            study = optuna.create_study(direction="maximize", sampler=make(parameters, seed))
            study.enqueue_trial({p.name: p.start for p in parameters})
            spaces = {p.name: p.distribution for p in parameters}
            while len(study.trials) < trials:
                asked = [study.ask(spaces) for _ in range(PER_GRASP)]
                for trial, told in zip(asked, evaluate([dict(t.params) for t in asked]), strict=True):
                    study.tell(trial, told.value)
                yield len(study.trials)

    return run


def cma(parameters: list[Parameter], seed: int) -> BaseSampler:
    """CMA-ES from the start, a fifth of the range wide, the generation of `pickproof tune` as its population."""
    width = min(p.high - p.low for p in parameters)
    start = {p.name: p.start for p in parameters}
    return CmaEsSampler(x0=start, sigma0=0.2 * width, seed=seed, popsize=PER_GRASP)


SEARCHES = {
    "pickproof": pickproof_search,
    "TPE": sampler_search(lambda p, seed: TPESampler(seed=seed, multivariate=True, constant_liar=True)),
    "CMA-ES": sampler_search(cma),
    "GP": sampler_search(lambda p, seed: GPSampler(seed=seed)),
}


def compare(name: str, point: GraspPoint, seed: int, trials: int, errors: Array, unseen: Array) -> Iterator[Outcome]:
    """Every search on one spoiled grasp point, under the same errors."""
    scenario = load_scenario(name)
    gripper = load_gripper(scenario.gripper)
    parameters = grasp_parameters(point, gripper, Reach())
    for label, search in SEARCHES.items():
        seen: list[tuple[float, Values]] = []

        def evaluate(asked: list[Values], seen: list[tuple[float, Values]] = seen) -> list[Told]:
            told = []
            for values in asked:
                task = GraspTask(
                    scenario.workpiece, scenario.gripper, moved(point, values), errors, distance(parameters, values)
                )
                told.append(try_point(task))
                seen.append((told[-1].value, values))
            return told

        for _ in search(parameters, seed, trials, evaluate):
            pass
        marks = [trials // 4, trials // 2, trials]
        best = [max(seen[:n], key=lambda row: row[0]) for n in marks]
        shares = [
            try_point(GraspTask(scenario.workpiece, scenario.gripper, moved(point, v), unseen)).detail["share"]
            for _, v in best
        ]
        yield Outcome(name, point.name, seed, label, [round(value, 4) for value, _ in best], shares)


def main() -> int:
    """Run it; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--workpieces", nargs="+", default=["bracket", "tless_20", "ps6d_7"], metavar="NAME")
    parser.add_argument("--grasps", type=int, default=2, help="grasp points of each (default 2)")
    parser.add_argument("--trials", type=int, default=72, help="budget of a search (default 72)")
    parser.add_argument("--seeds", type=int, default=2, help="ways of spoiling (default 2)")
    parser.add_argument("--out", type=Path, default=Path("out/tuning-search.jsonl"))
    args = parser.parse_args()
    args.out.parent.mkdir(parents=True, exist_ok=True)
    found: list[Outcome] = []
    for name in args.workpieces:
        scenario = load_scenario(name)
        workpiece, gripper = load_workpiece(scenario.workpiece), load_gripper(scenario.gripper)
        shipped = [p for p in read_table(workpiece.folder / "grasps.yaml").grasps if p.gripper in (None, gripper.name)]
        for seed in range(args.seeds):
            rng = np.random.default_rng(seed)
            errors, unseen = (draw_errors(rng, workpiece, None, draws) for draws in (6, 12))
            bad = spoiled(shipped[: args.grasps], getattr(gripper, "max_opening", np.inf), rng)
            for point in bad:
                for outcome in compare(name, point, seed, args.trials, errors, unseen):
                    found.append(outcome)
                    with args.out.open("a", encoding="utf-8") as file:
                        file.write(json.dumps(asdict(outcome)) + "\n")
                    print(outcome, flush=True)
    for label in SEARCHES:
        own = [o for o in found if o.search == label]
        value, held = np.mean([o.values for o in own], axis=0), np.mean([o.held for o in own], axis=0)
        print(f"{label:10} value {np.round(value, 3)}  held under unseen errors {np.round(held, 3)}  ({len(own)} runs)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
