"""A pool whose episodes run in the driver's process: for planted episodes, where a worker is not what is tested.

That campaigns give the same records for any number of worker processes is tested in campaign/test_campaign.py.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence

from pickproof.scenarios.campaign import process_pool
from pickproof.scenarios.campaign.executor import Event, Failure, Message, Task, checked, run_one


class InProcess:
    """One episode after the other; see `Pool`."""

    def __init__(self, task: Task, size: int, interrupted: Callable[[], bool]) -> None:
        self._task, self._interrupted = task, interrupted
        self._waiting: deque[int] = deque()

    def run(self, seeds: Sequence[int]) -> Iterator[Event | Failure]:
        self._waiting.extend(seeds)
        while self._waiting:
            seed = self._waiting.popleft()
            messages: list[Message] = []
            run_one(self._task, seed, messages.append)
            for message in messages:
                if self._interrupted():
                    raise KeyboardInterrupt
                yield checked(message, seed)

    def again(self, seed: int) -> None:
        self._waiting.appendleft(seed)

    def stop(self) -> Iterator[Event]:
        yield from ()


def episodes_in_this_process() -> None:
    """For the rest of this process; a test takes the fixture `in_process` instead."""
    process_pool.Workers = InProcess  # type: ignore[misc, assignment]
