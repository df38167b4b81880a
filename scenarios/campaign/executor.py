"""Executors of a campaign's episodes: worker processes (`process_pool.py`) or a Ray cluster (`ray_pool.py`).

In both, an episode is one task, identified by the scenario's hash and its seed. A repeated task gives the same records.
Only the driver writes them.
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
# one thread per worker and no GPU: the order of additions, and so the result, must not depend on the load
WORKER_ENVIRONMENT = {**dict.fromkeys(_LIBRARIES, "1"), "OMP_WAIT_POLICY": "PASSIVE", "CUDA_VISIBLE_DEVICES": ""}

Kind = Literal["broken", "crashed", "killed"]
"""The physics failed; the process crashed or hung; it was killed, or its machine was lost."""


@dataclass(frozen=True)
class Event:
    """An event: an attempt or an episode ended, or an episode is repeated."""

    seed: int
    attempt: AttemptRecord | None = None
    episode: EpisodeRecord | None = None


@dataclass(frozen=True)
class Failure:
    """An episode that did not finish."""

    seed: int
    message: str
    kind: Kind


@dataclass(frozen=True)
class Task:
    """What the episodes of a campaign have in common; sent to the workers.

    Attributes:
        first: the job of the first episode; the others differ by their seed.
        identity: `inputs`, `versions`, `weights_hash`, ... that a worker must have.
        stall_s: [s] without a message from a busy worker after which it counts as hung.
    """

    runner: Runner
    first: Job
    identity: Mapping[str, Any]
    stall_s: float = STALL_S

    def job(self, seed: int) -> Job:
        """The job of one episode."""
        return replace(self.first, seed=seed)


Message = Event | Failure | PickproofError | str
"""A message of a worker; a string is the traceback of a bug."""


class Pool(Protocol):
    """Runs episodes and yields their events."""

    def run(self, seeds: Sequence[int]) -> Iterator[Event | Failure]:
        """Events of the episodes, begun in this order, as they happen.

        Raises:
            PickproofError: a worker met bad input.
            RuntimeError: a bug in a worker; the message holds its traceback.
            KeyboardInterrupt: the driver received a request to stop.
        """
        ...

    def again(self, seed: int) -> None:
        """Put a seed back at the front of the queue."""
        ...

    def stop(self) -> Iterator[Event]:
        """Stop all workers; returns messages that were sent but not read."""
        ...


def run_one(task: Task, seed: int, send: Callable[[Message], None]) -> None:
    """Run an episode and send its events; the last message is its end, a `Failure`, or an error."""
    try:
        _check_profile(task)
        episode = task.runner(task.job(seed), lambda a: send(Event(a.seed, attempt=a)))
        send(Event(seed, episode=episode))
    except SimulationError as error:  # deterministic for the seed: not repeated
        send(Failure(seed, str(error), "broken"))
    except PickproofError as error:
        send(PickproofError(str(error)))  # its class may not be picklable
    except Exception as error:  # noqa: BLE001  handed to the driver, which raises it
        send("".join(traceback.format_exception(error)))


def _check_profile(task: Task) -> None:
    wanted = task.identity["versions"]["numerics"]
    if not has_profile(wanted):
        raise PickproofError(f"a worker does not use the numeric profile {wanted} of this campaign")


def checked(message: Message, seed: int) -> Event | Failure:
    """The message of a worker; errors are raised."""
    if isinstance(message, PickproofError):
        raise message
    if isinstance(message, str):
        raise RuntimeError(f"episode {seed} failed in its worker:\n{message}")
    return message
