import re
import struct
import zlib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pickproof.scenarios.campaign.job import Job
from pickproof.scenarios.config.input_hashes import versions
from pickproof.scenarios.config.scenario import load_scenario, scenario_hash, scenario_json
from pickproof.scenarios.reporting.figures import library
from pickproof.scenarios.reporting.report import choose_shown, write_report
from pickproof.scenarios.reporting.tables import by_place, classes, fill_levels, grasp_points, uncovered_percent
from pickproof.scenarios.reporting.verdict_counts import condensed, verdict_counts
from pickproof.scenarios.results.records import AttemptRecord, EpisodeRecord
from pickproof.scenarios.results.store import Store
from pickproof.scenarios.results.summary import summarise
from tests.scenarios.browser import CHROMIUM, Browser
from tests.scenarios.fake_episode import fake_attempt, run_episode

pytestmark = pytest.mark.slow


def meta(**changes):
    s = load_scenario("bracket")
    base = {"scenario": scenario_json(s), "scenario_hash": scenario_hash(s), "seed": 0, "oracle": [], "episodes": 2}
    return base | {"weights_hash": "", "versions": versions(), "command": "pickproof run", "wall_s": 1.0} | changes


def png(size):
    """A grey square of about `size` bytes that does not compress."""
    side = int(size**0.5)
    rows = b"".join(b"\0" + np.random.default_rng(r).bytes(side) for r in range(side))
    parts = [(b"IHDR", struct.pack(">2I5B", side, side, 8, 0, 0, 0, 0)), (b"IDAT", zlib.compress(rows)), (b"IEND", b"")]
    chunks = (struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d)) for k, d in parts)
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def attempt(i, reason="", **changes):
    return AttemptRecord(0, i, True, reason == "", reason, 10, 1, grasp="step", pictures={"depth": png(900)}, **changes)


def filled(out, episodes=2, **changes):
    scenario = load_scenario("bracket")
    with Store.create(out, meta(**changes)) as store:
        for seed in range(episodes):
            store.add_episode(run_episode(Job(scenario, seed, pictures=True), store.add_attempt))
    return out


def test_page_is_whole_and_self_contained(tmp_path):
    path = write_report(filled(tmp_path, command="pickproof run 'a <b>'"))
    page = path.read_text()
    with Store.read(tmp_path) as store:
        s = summarise(store)
    for text in (f"{100 * s['success_rate']:.1f} %", s["record_hash"], s["scenario_hash"], "&lt;b&gt;", "slipped"):
        assert text in page
    outside = page.replace(library(), "")
    assert len(outside) < len(page) - 1_000_000 and page.count(library()) == 1
    assert not re.search(r"(src|href)=(?!\"data:)", outside)
    assert path.stat().st_size < 12_000_000


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")
def test_the_page_draws_its_figures_and_fetches_nothing(tmp_path):
    path = write_report(filled(tmp_path / "run"))
    with Browser(tmp_path) as browser:
        browser.open(path.as_uri())
        browser.until("document.querySelectorAll('.js-plotly-plot .main-svg').length >= 6")
        drawn = browser.run("[...document.querySelectorAll('.js-plotly-plot')].map(d => d.id).sort().join()")
        assert drawn == "bin_map,cycle,dependence_0,dependence_1,dependence_2,pareto"
        assert browser.run("document.querySelectorAll('#pareto .bars path').length") >= 1
        assert browser.errors == []
        assert [u for u in browser.requests if not u.startswith(("data:", "blob:"))] == [path.as_uri()]


TOO_WIDE = """[...document.querySelectorAll('section, .card, .plots > div')]
    .filter(e => e.scrollWidth > e.clientWidth + 1).map(e => e.textContent.slice(0, 40)).join('; ')"""


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")
@pytest.mark.parametrize("width", [1200, 390])
def test_nothing_is_wider_than_its_card(tmp_path, width):
    """A grasp point has a long name and the phone is narrow; plots stand below each other there."""
    out, name = filled(tmp_path / "run", 1), "jaw_on_the_long_side_of_the_bracket_turned_by_180_degrees"
    with Store.resume(out) as store:
        for i in range(3):
            store.add_attempt(replace(attempt(i), seed=7, grasp=name, pictures={}))
    path = write_report(out)
    with Browser(tmp_path) as browser:
        browser.send("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False)
        browser.open(path.as_uri())
        browser.until("document.querySelectorAll('.js-plotly-plot .main-svg').length >= 6")
        assert browser.run(TOO_WIDE) == ""
        assert browser.run("document.documentElement.scrollWidth") == width
        columns = "new Set([...document.querySelectorAll('.plot')].map(e => e.getBoundingClientRect().left)).size"
        assert browser.run(columns) == (2 if width == 1200 else 1)


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")
def test_the_map_is_to_scale_with_the_outline_of_the_bin(tmp_path):
    path = write_report(filled(tmp_path / "run"))
    inner = load_scenario("bracket").source_bin.inner
    with Browser(tmp_path) as browser:
        browser.open(path.as_uri())
        browser.until("document.querySelectorAll('#bin_map .shapelayer path').length == 1")
        outline = "document.querySelector('#bin_map .shapelayer path').getBoundingClientRect()"
        ratio = browser.run(f"({outline}.width - 3) / ({outline}.height - 3)")
        assert ratio == pytest.approx(inner[0] / inner[1], rel=0.02)
        scale = browser.run("document.getElementById('bin_map').data[0].colorscale[0][1]")
        assert scale == "#00224e"  # cividis
        ticks = browser.run("[...document.querySelectorAll('#pareto .ytick text')].map(e => e.textContent).join()")
        assert all(float(t).is_integer() for t in ticks.split(","))


def written(out, records, ends=(), **changes):
    with Store.create(out, meta(**changes)) as store:
        for a in records:
            store.add_attempt(a)
        for end in ends:
            store.add_episode(end)
    return write_report(out).read_text().replace(library(), "")


def test_one_reason_is_a_line_of_text(tmp_path):
    alone = written(tmp_path / "a", [attempt(0), attempt(1, "missed"), attempt(2, "missed")])
    assert "One reason alone: <b>missed</b>, 2 times" in alone and 'id="pareto"' not in alone
    both = written(tmp_path / "b", [attempt(0), attempt(1, "missed"), attempt(2, "slipped")])
    assert "One reason alone" not in both and 'id="pareto"' in both


def test_numbers_come_before_pictures(tmp_path):
    page = written(tmp_path, [attempt(0), attempt(1, "missed")], [EpisodeRecord(0, 5, 1, "stopped", 2, 1.0)])
    titles = re.findall("<h2>(.*?)</h2>", page)
    assert titles.index("Grasp points") < titles.index("Episodes") < titles.index("Charts") < titles.index("Pictures")


def test_grasp_points_that_were_never_used_are_folded(tmp_path):
    tree = [{"score": 1.0, "ruled_out": {"step": {"tilt": 3}, "never": {"gripper_bin": 1}}, "candidates": []}]
    page = written(tmp_path, [replace(attempt(0), tree=tree)])
    used, folded = page.split('<details id="unused">')
    assert "1 grasp point never used" in folded and "never<div" in folded.split("</details>")[0]
    assert "1 of 1" in used and "never<div" not in used


@pytest.mark.parametrize(("picked", "limit", "amber"), [(2, 80, True), (6, 80, False), (2, 1, False)])
def test_a_rate_that_leaves_parts_in_the_bin_is_amber(tmp_path, picked, limit, amber):
    """Where the stop rule ends an episode before its bin can be empty, clearance says nothing."""
    scenario = load_scenario("bracket", ["count=6", f"stop.attempt_limit={limit}"])
    ends = [EpisodeRecord(seed, 6, picked, "stuck", 1, 1.0) for seed in (0, 1)]
    page = written(tmp_path, [attempt(0)], ends, scenario=scenario_json(scenario))
    assert ('<div class="card head amber">' in page) == amber
    assert f"{6 - picked}.0 workpieces left a bin" in page and "100.0 %" in page


def test_a_script_in_a_name_stays_text(tmp_path):
    with Store.create(tmp_path, meta()) as store:
        store.add_attempt(replace(attempt(0, "missed"), grasp="</script><script>alert(1)</script>"))
    assert "<script>alert(1)" not in write_report(tmp_path).read_text()


def test_grasp_points_say_what_ruled_them_out():
    tree = [
        {
            "score": 1.0,
            "ruled_out": {"step": {"tilt": 3}, "never": {"gripper_bin": 1}},
            "candidates": [{"grasp": "step", "verdict": "path_blocked", "terms": {}}],
        }
    ]
    rows = {r.label: r for r in grasp_points([replace(attempt(0), tree=tree)])}
    assert (rows["step"].n, rows["step"].why) == (1, "tilt 75 %, path blocked 25 %")
    assert (rows["never"].n, rows["never"].why) == (0, "gripper bin 100 %")


def test_a_condensed_tree_counts_the_same():
    estimates = [
        {
            "score": 1.0,
            "ruled_out": {"step": {"tilt": 3, "no_ik": k}, "flange": {"tilt": 2}, "never": {}},
            "candidates": [
                {"grasp": "step", "verdict": "path_blocked", "terms": {}},
                {"grasp": "edge", "verdict": "chosen" if k == 1 else "outranked", "terms": {"uncovered": 0.9}},
            ],
        }
        for k in range(3)
    ]
    whole, short = (replace(attempt(0), tree=t) for t in (estimates, condensed(estimates)))
    assert verdict_counts(short.tree) == verdict_counts(whole.tree)
    assert uncovered_percent(short) == uncovered_percent(whole) is not None
    assert grasp_points([short]) == grasp_points([whole])
    assert condensed(None) is None and condensed({"error": "x"}) == {"error": "x"}


def test_the_place_in_the_bin_is_where_the_estimate_lies():
    source = load_scenario("bracket").source_bin.build("source")
    T = np.eye(4)
    T[:3, 3] = np.add(source.position, (source.inner[0] * 0.49, -source.inner[1] * 0.49, 0.01))
    good, tried = by_place([attempt(0, estimate_T_world_part=T), attempt(1, "missed", estimate_T_world_part=T)], source)
    assert (tried[0, -1], good[0, -1], tried.sum()) == (2, 1, 2)


@settings(deadline=None, max_examples=30)
@given(st.lists(st.floats(0, 20), max_size=30))
def test_classes_hold_every_attempt_once(values):
    records = [attempt(i, error_mm=v, error_deg=0.0) for i, v in enumerate(values)]
    assert sum(s.n for s in classes(records, lambda a: a.error_mm, (0, 1, 5), " mm")) == len(values)


def test_unfinished_and_oracle_runs_say_so(tmp_path):
    page = write_report(filled(tmp_path / "a", episodes=5, oracle=["perception"])).read_text()
    assert "Oracle run" in page and "Not finished" not in page
    assert "Not finished" in write_report(filled(tmp_path / "b", episodes=1)).read_text()


@pytest.mark.parametrize("records", [[], [fake_attempt(0, 0, 5, 3, np.random.default_rng(8), False)]])
def test_a_campaign_with_next_to_nothing_in_it(tmp_path, records):
    with Store.create(tmp_path, meta()) as store:
        for a in records:
            store.add_attempt(a)
    assert "Run it again" in write_report(tmp_path).read_text()
    with Store.read(tmp_path) as store:
        s = summarise(store)
    if not records:
        assert (s["success_rate"], s["clearance"], s["picks_per_hour"], s["wilson95"]) == (None, None, None, [0.0, 1.0])


def test_no_attempt_moved(tmp_path):
    with Store.create(tmp_path, meta()) as store:
        store.add_attempt(AttemptRecord(0, 0, False, False, "no_detection", 5, 0))
        store.add_episode(EpisodeRecord(0, 5, 0, "stuck", 1, 1.0))
    assert "no detection" in write_report(tmp_path).read_text()


def test_failures_are_shown_first_and_within_the_budget(tmp_path):
    records = [attempt(i, "missed" if i % 3 == 0 else "") for i in range(30)]
    with Store.create(tmp_path, meta()) as store:
        for a in records:
            store.add_attempt(a)
        order = [x.attempt.reason for x in choose_shown(store, store.attempts())]
        few = choose_shown(store, store.attempts(), budget=5000)
    assert order == ["missed"] * 10 + [""] * 4
    assert {x.attempt.success for x in few} == {True, False}
    assert sum(len(uri) for x in few for _, uri in x.pictures) < 5000 * 4 / 3 + 200 * len(few)


def test_shares_add_up():
    rng = np.random.default_rng(2)
    records = [fake_attempt(0, i, 30 - i, 4, rng, False) for i in range(30)]
    moved = [a for a in records if a.moved]
    for shares in (fill_levels(records), grasp_points(records)):
        assert sum(x.n for x in shares) == len(moved)
        assert sum(x.good for x in shares) == sum(a.success for a in moved)
    assert fill_levels([]) == []
