"""What runs the episodes of a campaign: worker processes (`process_pool.py`) or a Ray cluster (`ray_pool.py`).

Whatever it is, an episode is one task, named by the scenario's hash and its seed. It may be run again at any time and
gives the same records; the driver alone writes them down.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol

from pickproof.cell.errors import PickproofError, SimulationError
from pickproof.cell.numerics import has_profile
from pickproof.scenarios.campaign.job import Job, Runner
from pickproof.scenarios.results.records import AttemptRecord, EpisodeRecord

STALL_S = 900.0  # [s]

_LIBRARIES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMEXPR_NUM_THREADS")
# one thread a worker, and no GPU: the order of additions, and so the results, must not depend on the machine's load
WORKER_ENVIRONMENT = {**dict.fromkeys(_LIBRARIES, "1"), "OMP_WAIT_POLICY": "PASSIVE", "CUDA_VISIBLE_DEVICES": ""}

Kind = Literal["broken", "crashed", "killed"]
"""The physics gave up; the process died of itself or hung; somebody killed it, or its machine went away."""


@dataclass(frozen=True)
class Event:
    """Something that happened: an attempt or an episode ended, or an episode is run again."""

    seed: int
    attempt: AttemptRecord | None = None
    episode: EpisodeRecord | None = None


@dataclass(frozen=True)
class Failure:
    """An episode that did not come to its end."""

    seed: int
    message: str
    kind: Kind


@dataclass(frozen=True)
class Task:
    """What the episodes of a campaign have in common; sent to the workers.

    Attributes:
        first: the job of the first episode; the others differ by their seed.
        identity: `inputs`, `versions`, `weights_hash`, ... that whoever runs an episode must have.
        stall_s: [s] without a word from a busy worker after which it counts as hung.
    """

    runner: Runner
    first: Job
    identity: Mapping[str, Any]
    stall_s: float = STALL_S

    def job(self, seed: int) -> Job:
        """That of one episode."""
        return replace(self.first, seed=seed)


Message = Event | Failure | PickproofError | str
"""What a worker sends; a string is the traceback of a bug."""


class Pool(Protocol):
    """Runs episodes and tells what happens in them."""

    def run(self, seeds: Sequence[int]) -> Iterator[Event | Failure]:
        """Events of the episodes, begun in this order, as they happen.

        Raises:
            PickproofError: a worker met bad input.
            RuntimeError: a worker met a bug; the message holds its traceback.
            KeyboardInterrupt: the driver was asked to stop.
        """
        ...

    def again(self, seed: int) -> None:
        """Put a seed back in front of the line."""
        ...

    def stop(self) -> Iterator[Event]:
        """End everything; what had been sent and nobody had read."""
        ...


def run_one(task: Task, seed: int, send: Callable[[Message], None]) -> None:
    """Run an episode and send what happens; the last message is its end, a `Failure`, or an error."""
    try:
        _check_profile(task)
        episode = task.runner(task.job(seed), lambda a: send(Event(a.seed, attempt=a)))
        send(Event(seed, episode=episode))
    except SimulationError as error:  # the same again for the same seed: no second try
        send(Failure(seed, str(error), "broken"))
    except PickproofError as error:
        send(PickproofError(str(error)))  # its own class may not travel
    except Exception as error:  # noqa: BLE001  handed to the driver, which raises it
        send("".join(traceback.format_exception(error)))


def _check_profile(task: Task) -> None:
    wanted = task.identity["versions"]["numerics"]
    if not has_profile(wanted):
        raise PickproofError(f"a worker does not compute by the numeric profile {wanted} of this campaign")


def checked(message: Message, seed: int) -> Event | Failure:
    """What a worker sent, errors raised."""
    if isinstance(message, PickproofError):
        raise message
    if isinstance(message, str):
        raise RuntimeError(f"episode {seed} failed in its worker:\n{message}")
    return message
