"""On a Ray node of its own; needs `pickproof[cluster]`."""

import os
import socket
import sys
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

import pytest
from fake_episode import run_episode

from cell.errors import InputError
from scenarios.campaign import run_campaign
from scenarios.cli import main
from scenarios.scenario import load_scenario
from scenarios.store import Store
from scenarios.summary import summarise
from tests.benchmarks.faults import descendants

# not imported here: Ray reads how far it may be seen when it is imported
needs_ray = pytest.mark.skipif(find_spec("ray") is None, reason="pickproof[cluster] is not installed")


def campaign(out, ray, gripper="jaw_v1", on_event=lambda event: None):
    run_campaign(
        load_scenario("bracket", [f"gripper='{gripper}'", "count=6", "stop.attempt_limit=20"]),
        episodes=3,
        seed=3,
        workers=2,
        oracle=frozenset({"perception"}),
        out=out,
        runner=run_episode,
        ray=ray,
        on_event=on_event,
    )
    with Store.read(out) as store:
        return summarise(store)


def listening():
    """Local addresses, in hexadecimal, on which this process and those below it listen."""
    mine = set()
    for pid in (os.getpid(), *descendants(os.getpid())):
        with suppress(OSError):  # it has ended
            mine |= {str(fd.readlink()) for fd in Path(f"/proc/{pid}/fd").iterdir()}
    lines = [line.split() for kind in ("tcp", "tcp6") for line in Path(f"/proc/net/{kind}").read_text().splitlines()]
    return {words[1] for words in lines if words[3] == "0A" and f"socket:[{words[9]}]" in mine}


@needs_ray
@pytest.mark.filterwarnings(
    "ignore::pytest.PytestUnraisableExceptionWarning", "ignore::ResourceWarning"
)  # Ray leaves pipes and processes to the collector
def test_ray_gives_the_records_of_this_machine_and_serves_on_loopback_only(tmp_path):
    opened, retries = set(), []

    def look(event):
        opened.update(listening())
        retries.extend([event.seed] if event.attempt is event.episode is None else [])

    far = campaign(tmp_path / "far", "local", f"killed:{tmp_path / 'mark'}", look)
    assert far["record_hash"] == campaign(tmp_path / "near", None)["record_hash"]
    assert len(retries) == 2
    loopback = ("0100007F", "0000000000000000FFFF00000100007F", "00000000000000000000000001000000")
    assert opened and {address.partition(":")[0] for address in opened} <= set(loopback)


@needs_ray
def test_an_address_without_a_cluster_is_one_line(capsys, tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    for bad in (address, "nowhere", "nowhere.invalid:6379"):
        with pytest.raises(InputError, match=rf"--ray: '{bad}' is not valid; expected local, auto, or HOST:PORT"):
            campaign(tmp_path / bad, bad)
        assert not (tmp_path / bad / "results.sqlite").exists()


def test_without_ray_the_extra_is_named(monkeypatch, capsys, tmp_path):
    monkeypatch.setitem(sys.modules, "ray", None)
    words = ["run", "bracket", "--oracle", "perception", "--ray", "local", "--out", str(tmp_path / "run")]
    assert main(words) == 2
    error = capsys.readouterr().err
    assert "pickproof[cluster]" in error and error.count("\n") == 1
    assert not (tmp_path / "run" / "results.sqlite").exists()
