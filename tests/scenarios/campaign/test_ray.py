"""On a Ray node of its own; needs `pickproof[cluster]`."""

import socket
import sys
from importlib.util import find_spec

import numpy as np
import pytest

from pickproof.cell.errors import InputError
from pickproof.scenarios.campaign.campaign import run_campaign
from pickproof.scenarios.campaign.request import CampaignRequest
from pickproof.scenarios.commands.cli import main
from pickproof.scenarios.config.scenario import load_scenario
from pickproof.scenarios.results.store import Store
from pickproof.scenarios.results.summary import summarise
from tests.benchmarks.faults import FAKE, SLOW, Nodes, storm
from tests.scenarios.fake_episode import run_episode
from tests.scenarios.sockets import listening, on_loopback

pytestmark = pytest.mark.slow

# not imported here: Ray reads how far it may be seen when it is imported
needs_ray = pytest.mark.skipif(find_spec("ray") is None, reason="pickproof[cluster] is not installed")
ray_leaves_rests = pytest.mark.filterwarnings(  # pipes and processes, to the collector
    "ignore::pytest.PytestUnraisableExceptionWarning", "ignore::ResourceWarning"
)


def campaign(out, ray, gripper="jaw_v1", on_event=lambda event: None):
    request = CampaignRequest(
        scenario=load_scenario("bracket", [f"gripper='{gripper}'", "count=6", "stop.attempt_limit=20"]),
        episodes=3,
        seed=3,
        workers=2,
        oracle=frozenset({"perception"}),
        out=out,
        runner=run_episode,
        ray=ray,
    )
    run_campaign(request, on_event)
    with Store.read(out) as store:
        return summarise(store)


@needs_ray
@ray_leaves_rests
def test_ray_gives_the_records_of_this_machine_and_serves_on_loopback_only(tmp_path):
    opened, retries = set(), []

    def look(event):
        opened.update(listening())
        retries.extend([event.seed] if event.attempt is event.episode is None else [])

    far = campaign(tmp_path / "far", "local", f"killed:{tmp_path / 'mark'}", look)
    assert far["record_hash"] == campaign(tmp_path / "near", None)["record_hash"]
    assert len(retries) == 2
    assert on_loopback(opened)


@needs_ray
@ray_leaves_rests
def test_a_killed_node_loses_and_doubles_nothing(tmp_path):
    """The driver goes on with the other node, or stops and is continued when the node that died was its own."""
    with Nodes() as nodes:
        assert on_loopback(listening())
        words = [*SLOW, "--oracle", "perception", "--episodes", "4", f"--ray={nodes.address}"]
        found = storm(tmp_path, 1, np.random.default_rng(0), words, FAKE, 0.0, 1.0, nodes, node_share=1.0)
    assert found.kills == {"node": 1} and found.harmless, found


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
