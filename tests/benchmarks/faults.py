"""Kills workers, drivers and Ray nodes at random moments: `python -m tests.benchmarks.faults --kills 200`.

Every campaign is finished with --resume and held against an undisturbed one: attempts lost, attempts doubled, record
hash. Episodes are those without physics (tests/scenarios/fake_episode.py) in real processes with real databases;
`--real` adds campaigns with physics, `--ray` those on a Ray cluster. Disk full and a locked file are tried too.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pickproof.cell.child_process import child_environment
from pickproof.cell.errors import PickproofError
from pickproof.scenarios.campaign.ray_pool import ON_LOOPBACK
from pickproof.scenarios.results.record_hash import record_hash
from pickproof.scenarios.results.store import FILE, Store

ROOT = Path(__file__).resolve().parents[2]
FAKE = [sys.executable, str(ROOT / "tests" / "scenarios" / "fake_cli.py")]
REAL = [sys.executable, "-m", "pickproof.scenarios.commands.cli"]
SLOW = ["run", "bracket", "--set", "count=6", "--set", "stop.attempt_limit=20", "--set", "gripper=slow"]
PHYSICS = ["run", "bracket", "--set", "count=3", "--oracle", "perception"]
MOMENT_S = 8.0
"""[s] between two kills at most: a worker that is killed each time before it has begun proves little."""
LOOPBACK = "127.0.0.1"
ON_NODES = ON_LOOPBACK | {"RAY_raylet_start_wait_time_s": "120", "RAY_USAGE_STATS_ENABLED": "0"}
"""A busy machine starts a node in half a minute, which is Ray's own patience."""
ORPHAN_S = 10.0
"""[s] in which the workers of a killed driver or node must be gone."""


@dataclass
class Storm:
    """What was done to campaigns and what came of them.

    Attributes:
        orphans: processes that outlived a killed driver or node.
        resumed: drivers that stopped by themselves, in one line that names --resume, when their node was killed.
    """

    kills: Counter[str] = field(default_factory=Counter)
    campaigns: int = 0
    lost: int = 0
    doubled: int = 0
    other_hash: int = 0
    orphans: int = 0
    resumed: int = 0

    @property
    def harmless(self) -> bool:
        """Nothing was lost, doubled, changed or left behind."""
        return not (self.lost or self.doubled or self.other_hash or self.orphans)


def storm(
    folder: Path,
    kills: int,
    rng: np.random.Generator,
    words: list[str],
    command: list[str] = FAKE,
    driver_share: float = 0.25,
    moment_s: float = MOMENT_S,
    cluster: Nodes | None = None,
    node_share: float = 0.2,
) -> Storm:
    """Campaigns one after the other until there have been that many kills, each finished in peace.

    Args:
        words: of the command line, without --out and --resume.
        driver_share: chance that a kill hits the driver; the others hit workers, or the second node of a `cluster`.
        moment_s: [s] between two kills at most.
        cluster: where the campaign runs when it runs on Ray.
        node_share: of the kills that do not hit the driver, those that hit the node.
    """
    found, calm = Storm(), folder / "calm"
    at_driver = (rng.random(kills) < driver_share).tolist()
    _finish(command, [*[w for w in words if not w.startswith("--ray")], "--out", str(calm)])
    while found.kills.total() < kills:
        out = folder / f"storm-{found.campaigns}"
        driver = _start(command, words, out)
        while found.kills.total() < kills and driver.poll() is None:
            time.sleep(rng.uniform(0.1, moment_s))
            workers = descendants(driver.pid) if cluster is None else cluster.workers()
            if driver.poll() is not None or not (workers or at_driver[found.kills.total()]):
                continue
            if at_driver[found.kills.total()]:
                driver.kill()
                driver.communicate()
                found.kills["driver"] += 1
                found.orphans += _left_after(ORPHAN_S, workers) if cluster is None else 0
                driver = _start(command, words, out)
            elif cluster is not None and rng.random() < node_share:
                if cluster.busy():
                    found.orphans += _left_after(ORPHAN_S, cluster.kill_node())
                    found.kills["node"] += 1
                    cluster.add_node()
            else:
                _kill(int(rng.choice(workers)))
                found.kills["worker"] += 1
        while not _finished(driver):
            found.resumed += 1
            driver = _start(command, words, out)
        found.campaigns += 1
        _compare(calm, out, found)
        print(f"{folder.name}: {found}", file=sys.stderr, flush=True)
    return found


def full_disk(folder: Path) -> str:
    """A campaign on a file system that fills up, continued once there is room; what came of it."""
    disk = folder / "disk"
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=256k", "none", disk], capture_output=True).returncode:
        return "not tried: no right to mount a small file system"
    try:
        words = [*SLOW, "--episodes", "40", "--workers", "2", "--no-pictures", "--set", "gripper=jaw_v1", "--out"]
        full = subprocess.run([*FAKE, *words, str(disk / "run")], capture_output=True, text=True)
        if full.returncode != 2 or "--resume" not in full.stderr or full.stderr.count("\n") != 1:
            return f"no clear stop: {full.returncode}, {full.stderr}"
        kept = len(_attempts(disk / "run"))
        subprocess.run(["mount", "-o", "remount,size=64m", disk], check=True)
        _finish(FAKE, [*words, str(disk / "run"), "--resume"])
        _finish(FAKE, [*words, str(folder / "room")])
        found = Storm()
        _compare(folder / "room", disk / "run", found)
        return f"stopped with {kept} attempts kept, continued: {'same records' if found.harmless else found}"
    finally:
        subprocess.run(["umount", disk], check=True)


def locked_file(folder: Path) -> str:
    """A campaign whose file another program holds for a minute, continued afterwards; what came of it."""
    words = [*SLOW, "--episodes", "6", "--workers", "2", "--out"]
    driver = _start(FAKE, words[:-1], folder / "locked")
    while not _attempts(folder / "locked"):
        time.sleep(0.1)
    other = sqlite3.connect(folder / "locked" / FILE, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    error = driver.communicate()[1].decode()
    other.rollback()
    other.close()
    if driver.returncode != 2 or "--resume" not in error or error.count("\n") != 1:
        return f"no clear stop: {driver.returncode}, {error}"
    _finish(FAKE, [*words, str(folder / "locked"), "--resume"])
    _finish(FAKE, [*words, str(folder / "free")])
    found = Storm()
    _compare(folder / "free", folder / "locked", found)
    return f"stopped, continued: {'same records' if found.harmless else found}"


class Nodes:
    """A Ray cluster of a head and one node on this machine, on loopback alone; use it as a context manager."""

    def __init__(self) -> None:
        head = {"num_cpus": 1, "include_dashboard": False, "node_ip_address": LOOPBACK}
        with child_environment(_environment() | ON_NODES):
            from ray.cluster_utils import Cluster

            self._cluster = Cluster(initialize_head=True, head_node_args=head)
        self.address: str = self._cluster.address
        self.add_node()

    def __enter__(self) -> Nodes:
        return self

    def __exit__(self, *_: object) -> None:
        self._cluster.shutdown()

    def add_node(self) -> None:
        """The second node, with room for one episode."""
        with child_environment(_environment() | ON_NODES):
            self._node = self._cluster.add_node(num_cpus=1, node_ip_address=LOOPBACK)

    def workers(self) -> list[int]:
        """Processes that run an episode, and those of Ray above them, on both nodes."""
        return [pid for pid in descendants(os.getpid()) if "ray::_episode" in _name(pid) or "spawn_main" in _name(pid)]

    def busy(self) -> bool:
        """The second node is in the middle of an episode."""
        return any("spawn_main" in _name(pid) for pid in self._below())

    def kill_node(self) -> list[int]:
        """SIGKILL for the second node's own process; those below it, which must end with it."""
        (raylet,) = (p.process.pid for found in self._node.all_processes.values() for p in found)
        below = self._below()
        _kill(raylet)
        self._cluster.remove_node(self._node, allow_graceful=False)
        return below

    def _below(self) -> list[int]:
        return [d for found in self._node.all_processes.values() for p in found for d in descendants(p.process.pid)]


def _finished(driver: subprocess.Popen[bytes]) -> bool:
    """Wait for its end; false when it stopped in one line that says how to go on."""
    error = driver.communicate()[1].decode()
    if driver.returncode == 2 and "--resume" in error and error.count("\n") == 1:
        return False
    if driver.returncode != 0:
        raise SystemExit(f"the driver ended with {driver.returncode}: {error}")
    return True


def _start(command: list[str], words: list[str], out: Path) -> subprocess.Popen[bytes]:
    resume = ["--resume"] if _has_results(out) else []
    return subprocess.Popen(
        [*command, *words, "--out", str(out), *resume],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env=_environment(),
        start_new_session=True,
    )


def _finish(command: list[str], words: list[str]) -> None:
    done = subprocess.run([*command, *words], capture_output=True, text=True, env=_environment())
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(words)}: {done.stderr}")


def _environment() -> dict[str, str]:
    paths = [str(ROOT), os.environ.get("PYTHONPATH", "")]
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))}


def _has_results(out: Path) -> bool:
    """A driver that is killed while it makes the file leaves none that can be continued, and nothing in it."""
    if not (out / FILE).exists():
        return False
    try:
        with Store.read(out) as store:
            if "inputs" in store.meta():
                return True
    except PickproofError:
        pass
    for file in out.glob(f"{FILE}*"):
        file.unlink()
    return False


def _attempts(out: Path) -> list[Any]:
    try:
        with Store.read(out) as store:
            return store.attempts()
    except PickproofError:
        return []


def _compare(calm: Path, stormy: Path, found: Storm) -> None:
    with Store.read(calm) as store:
        expected = (
            Counter((a.seed, a.attempt) for a in store.attempts()),
            record_hash(store.attempts(), store.episodes()),
        )
    with Store.read(stormy) as store:
        there = Counter((a.seed, a.attempt) for a in store.attempts()), record_hash(store.attempts(), store.episodes())
    found.lost += (expected[0] - there[0]).total()
    found.doubled += (there[0] - expected[0]).total()
    found.other_hash += expected[1] != there[1]


def descendants(pid: int) -> list[int]:
    """Processes below `pid` but for Python's own helper."""
    below, level = [], [pid]
    while level:
        level = [c for p in level for c in _children(p)]
        below += [p for p in level if "resource_tracker" not in _name(p)]
    return below


def _children(pid: int) -> list[int]:
    try:
        return [int(c) for t in Path(f"/proc/{pid}/task").iterdir() for c in (t / "children").read_text().split()]
    except OSError:
        return []


def _name(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_text().replace("\0", " ")
    except OSError:
        return ""


def _kill(pid: int) -> None:
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        return  # it ended by itself in the meantime


def _left_after(seconds: float, pids: list[int]) -> int:
    """How many of the processes are still there after that time."""
    deadline = time.monotonic() + seconds
    while (left := [p for p in pids if _name(p)]) and time.monotonic() < deadline:
        time.sleep(0.05)
    for pid in left:
        _kill(pid)
    return len(left)


def main() -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200, metavar="N", help="of episodes without physics (default 200)")
    parser.add_argument("--real", type=int, default=0, metavar="N", help="kills of episodes with physics")
    parser.add_argument("--ray", type=int, default=0, metavar="N", help="kills on a Ray cluster of two nodes")
    parser.add_argument("--seed", type=int, default=0, help="of the moments and the victims")
    parser.add_argument("--json", type=Path, metavar="FILE")
    args = parser.parse_args()
    rng, found = np.random.default_rng(args.seed), dict[str, Any]()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if args.kills:
            (folder / "fake").mkdir()
            words = [*SLOW, "--episodes", "12", "--workers", "2"]
            found["without physics"] = storm(folder / "fake", args.kills, rng, words)
            found["disk full"], found["file locked"] = full_disk(folder), locked_file(folder)
        if args.real:
            words = [*PHYSICS, "--episodes", "4", "--workers", "2"]
            (folder / "real").mkdir()
            found["with physics"] = storm(folder / "real", args.real, rng, words, REAL, moment_s=30.0)
        if args.ray and importlib.util.find_spec("ray") is None:
            found["ray"] = "not tried: ray is not installed"
        elif args.ray:
            (folder / "ray").mkdir()
            with Nodes() as nodes:
                words = [*SLOW, "--oracle", "perception", "--episodes", "12", f"--ray={nodes.address}"]
                found["ray"] = storm(folder / "ray", args.ray, rng, words, cluster=nodes)
    for title, result in found.items():
        print(f"{title}: {result}", flush=True)
    if args.json:
        args.json.write_text(json.dumps(found, default=lambda s: vars(s), indent=1) + "\n", encoding="utf-8")
    return 0 if all(not isinstance(s, Storm) or s.harmless for s in found.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
