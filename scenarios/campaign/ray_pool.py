"""Episodes on a Ray cluster (`pip install pickproof[cluster]`).

A Ray task runs one episode, in a worker process of its own on the node (`process_pool.py`): the same environment, one
thread a library, the same records as here. Its attempts stream to the driver, which alone writes them down; the object
store holds nothing that is not read at once. A task that is lost with its node is begun again from the seed.
"""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

from pickproof.cell.child_process import child_environment
from pickproof.cell.errors import InputError, PickproofError
from pickproof.scenarios.campaign.executor import WORKER_ENVIRONMENT, Event, Failure, Message, Task, checked
from pickproof.scenarios.campaign.process_pool import Workers
from pickproof.scenarios.config.input_hashes import changed, input_hashes, versions
from pickproof.scenarios.config.scenario import scenario_hash, weights_used

# read by Ray when it is imported: a node that no cluster can join serves on 127.0.0.1 only, whatever the system
ON_LOOPBACK = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0"}
REACH_S = 5.0
"""[s] in which a cluster must answer."""
LOST_S = 120.0
"""[s] beyond the time of a hung episode after which a task without a word is given up."""
_POLL_S = 0.25


class ClusterError(PickproofError):
    """The cluster went away."""


@contextmanager
def connected(
    address: str,
    workers: int,
    task: Task,
    interrupted: Callable[[], bool],
) -> Iterator[Cluster]:
    """A pool on the cluster at `address`, or on one that is started here for `local`, on loopback alone.

    Args:
        workers: episodes at a time; 0 for all processors of the cluster.

    Raises:
        InputError: Ray is not installed, or nothing answers at the address.
    """
    environment = {**WORKER_ENVIRONMENT, "RAY_USAGE_STATS_ENABLED": "0"}
    if address == "local":
        environment["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
    if address == "local" or _is_on_loopback_only(address):
        environment |= ON_LOOPBACK
    with _own_signals(), child_environment(environment):
        ray = _ray(address)
        quiet: dict[str, Any] = {"log_to_driver": False, "configure_logging": False}
        if address == "local":
            try:
                ray.init(address="local", num_cpus=workers or None, include_dashboard=False, **quiet)
            except Exception as error:  # noqa: BLE001  Ray raises plain ones, as on a machine too busy to start in 30 s
                raise ClusterError(f"Ray did not start here ({_line(error)})") from None
            _check_loopback(ray)
        else:
            _check_reachable(address)
            try:
                ray.init(address=address, **quiet)
            except (ConnectionError, RuntimeError, ValueError, TimeoutError) as error:
                valid = f"a Ray cluster that answers ({_line(error)})"
                raise InputError("command line", "--ray", address, valid) from None
    try:
        yield Cluster(ray, address, workers, task, interrupted)
    finally:
        ray.shutdown()


class Cluster:
    """Ray tasks, one an episode; see `Pool`."""

    def __init__(
        self,
        ray: Any,
        address: str,
        workers: int,
        task: Task,
        interrupted: Callable[[], bool],
    ) -> None:
        self._ray, self._address, self._workers, self._interrupted = ray, address, workers, interrupted
        self._name = scenario_hash(task.first.scenario)[:16]
        self._lost_s = task.stall_s + LOST_S
        self._task = ray.put(task)
        self._remote = ray.remote(num_cpus=1, num_returns="streaming", max_retries=0)(_episode)
        self._running: dict[Any, int] = {}
        self._heard: dict[Any, float] = {}
        self._waiting: deque[int] = deque()

    def run(self, seeds: Sequence[int]) -> Iterator[Event | Failure]:
        """See `Pool.run`."""
        self._waiting.extend(seeds)
        while self._waiting or self._running:
            self._assign()
            ready, _ = self._ray.wait(list(self._running), timeout=_POLL_S, fetch_local=False)
            if self._interrupted():
                raise KeyboardInterrupt
            for stream in ready:
                yield self._hear(stream)
            for stream, heard in list(self._heard.items()):
                if time.monotonic() - heard > self._lost_s:
                    self._ray.cancel(stream, force=True)
                    yield self._lost(stream, f"no word from its node for {self._lost_s:.0f} s")

    def again(self, seed: int) -> None:
        """See `Pool.again`."""
        self._waiting.appendleft(seed)

    def stop(self) -> Iterator[Event]:
        """See `Pool.stop`."""
        with suppress(self._ray.exceptions.RayError, ConnectionError):
            while self._running:
                ready, _ = self._ray.wait(list(self._running), timeout=0, fetch_local=False)
                if not ready:
                    break
                event = self._hear(ready[0])
                if isinstance(event, Event):
                    yield event
            for stream in self._running:
                self._ray.cancel(stream, force=True)
        self._running.clear()

    def _assign(self) -> None:
        room = self._workers or int(self._ray.cluster_resources().get("CPU", 1))
        while self._waiting and len(self._running) < room:
            seed = self._waiting.popleft()
            stream = self._remote.options(name=f"{self._name}-{seed}").remote(seed, self._task)
            self._running[stream], self._heard[stream] = seed, time.monotonic()

    def _hear(self, stream: Any) -> Event | Failure:
        seed, errors = self._running[stream], self._ray.exceptions
        self._heard[stream] = time.monotonic()
        try:
            message: Message = self._ray.get(next(stream))
        except StopIteration:
            return self._lost(stream, "its task ended without a word")
        except errors.RayTaskError as error:
            raise RuntimeError(f"episode {seed} failed in its task:\n{error}") from None
        except (errors.LocalRayletDiedError, errors.RaySystemError) as error:
            raise ClusterError(
                f"{self._address}: the Ray cluster is gone ({_line(error)}); --resume continues"
            ) from None
        except errors.RayError as error:
            return self._lost(stream, _line(error))
        event = checked(message, seed)
        if isinstance(event, Failure) or event.episode is not None:
            del self._running[stream], self._heard[stream]
        return event

    def _lost(self, stream: Any, message: str) -> Failure:
        del self._heard[stream]
        return Failure(self._running.pop(stream), message, "killed")


_workers: Workers | None = None


def _episode(seed: int, task: Task) -> Iterator[Message]:
    """The Ray task: an episode in a worker process, which the node keeps for the next one."""
    global _workers
    scenario, oracle = task.first.scenario, task.first.oracle
    have = {
        "inputs": input_hashes(scenario, oracle),
        "versions": versions(),
        "weights_hash": weights_used(scenario, oracle),
    }
    different = changed(task.identity, have)
    if different:
        yield PickproofError(f"node {socket.gethostname()}: has other {', '.join(different)} than the driver")
        return
    if _workers is None:
        _workers = Workers(task, 1, lambda: False)
    try:
        yield from _workers.run([seed])
    except PickproofError as error:
        yield PickproofError(str(error))
    except RuntimeError as error:
        yield str(error)


def _ray(address: str) -> Any:
    try:
        import ray
    except ImportError:
        raise InputError("command line", "--ray", address, "Ray installed: pip install 'pickproof[cluster]'") from None
    return ray


def _check_loopback(ray: Any) -> None:
    """A program that imported Ray by itself before would have the node serve every network."""
    if ray.util.get_node_ip_address() not in ("127.0.0.1", "::1"):
        ray.shutdown()
        raise InputError("command line", "--ray", "local", "a process that has not imported Ray before")


def _is_on_loopback_only(address: str) -> bool:
    """Ray takes the machine's outward address for 127.0.0.1 by itself, and waits for ever where none answers there."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if host not in ("127.0.0.1", "localhost") or not port.isdigit():
        return False
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
            asked.connect(("192.0.2.1", 9))  # of documentation, RFC 5737; nothing is sent
            outward = asked.getsockname()[0]
        socket.create_connection((outward, int(port)), REACH_S).close()
    except (OSError, OverflowError):
        return True
    return False


def _check_reachable(address: str) -> None:
    """So that a wrong address costs seconds, not minutes of Ray's own patience."""
    if address == "auto":
        return
    host, _, port = address.removeprefix("ray://").rpartition(":")
    try:
        socket.create_connection((host, int(port)), REACH_S).close()
    except (OSError, ValueError, OverflowError) as error:
        valid = f"local, auto, or HOST:PORT of a Ray cluster that answers ({error})"
        raise InputError("command line", "--ray", address, valid) from None


@contextmanager
def _own_signals() -> Iterator[None]:
    """Ray takes SIGTERM for itself; the campaign wants it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {s: signal.getsignal(s) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for s, handler in before.items():
            signal.signal(s, handler)


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
