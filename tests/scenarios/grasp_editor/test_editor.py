"""The grasp editor as a user meets it, in a real browser and with real physics, on a copy of the file."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import pytest

from pickproof.cell.frames import from_quat_xyzw, make_transform
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.grasping.grasp_points import read_table
from pickproof.scenarios.grasp_editor.editor import GraspEditor
from pickproof.scenarios.grasp_editor.film import HeapCell, try_free
from pickproof.scenarios.grasp_editor.snapping import frame_of
from pickproof.scenarios.grasp_trials.trial import TrialCell
from tests.scenarios.browser import CHROMIUM, Browser

pytestmark = pytest.mark.slow

BRACKET, JAW = load_workpiece("bracket"), load_gripper("jaw_v1")
PATIENCE = 240.0  # [s] that a busy machine may take


@pytest.fixture
def table(tmp_path: Path) -> Path:
    return Path(shutil.copy(BRACKET.folder / "grasps.yaml", tmp_path / "grasps.yaml"))


@pytest.fixture
def editor(table: Path) -> Iterator[GraspEditor]:
    built = GraspEditor(BRACKET, JAW, table, port=0)
    yield built
    built.close()


def soon(condition: Callable[[], object]) -> None:
    begun = time.monotonic()
    while not condition():
        assert time.monotonic() - begun < PATIENCE
        time.sleep(0.05)


def shown(editor: GraspEditor) -> str:
    """What the page says in its banner and its tables."""
    panel = editor._panel
    return "\n".join((panel._banner.content, panel._theirs.content, panel._results.content, panel._diff.content))


def test_a_drag_is_judged_while_it_lasts_and_is_one_change_when_it_ends(editor: GraspEditor) -> None:
    begun = editor.document.text
    T = frame_of(editor.document.points[0])
    editor._dragged(T @ make_transform(t=(0.006, 0.0, 0.0)), "start")
    soon(lambda: "would penetrate the part" in editor._panel._verdict.content)
    assert editor.document.text == begun
    editor._dragged(T @ make_transform(t=(0.0, 0.004, 0.0)), "end")
    soon(lambda: editor.document.text != begun)
    moved = np.subtract(editor.document.points[0].centre, T[:3, 3])
    assert np.linalg.norm(moved) == pytest.approx(0.004, abs=0.002)  # it may snap
    editor.act("undo")
    assert editor.document.text == begun


def test_a_try_says_what_the_physics_says(editor: GraspEditor) -> None:
    """In every resting pose and in the heap, within 3 s of processor time."""
    soon(lambda: not editor._panel._try.disabled)
    spent = np.inf
    for _ in range(2):  # the first compiles what is not in the cache
        begun = time.process_time()
        editor.try_it("everywhere")
        soon(lambda: not editor._panel._try.disabled)
        spent = min(spent, time.process_time() - begun)
    outcomes = editor._tries._outcomes
    assert {name for name, outcome in outcomes.items() if outcome.held} >= {"resting pose 0"}
    assert "in a heap" in outcomes and "holds, slips" in shown(editor)
    assert spent < 3.0
    assert all(outcome.reason for outcome in outcomes.values() if not outcome.held)


def test_a_grasp_that_held_nowhere_is_not_sent_to_be_saved(editor: GraspEditor) -> None:
    soon(lambda: not editor._panel._try.disabled)
    editor.document.change(0, {"centre": (0.2, 0.0, 0.0)})
    editor.try_it("resting pose 0")
    soon(lambda: not editor._panel._try.disabled)
    assert not any(outcome.held for outcome in editor._tries._outcomes.values())
    assert "held nowhere" in editor._panel.hint.content


def test_two_edits_of_one_file_are_noticed_and_neither_is_lost(editor: GraspEditor, table: Path) -> None:
    theirs = table.read_text().replace("width: 0.012", "width: 0.0125")
    editor.act("on / off")
    mine = editor.document.text
    table.write_text(theirs)
    editor.act("show changes")
    editor.act("save")
    assert "Not saved" in shown(editor) and "0.0125" in shown(editor) and table.read_text() == theirs
    editor.act("overwrite")
    assert table.read_text() == mine
    assert table.with_name("grasps.yaml.theirs-1").read_text() == theirs


def test_a_broken_file_is_shown_and_its_mending_noticed(table: Path) -> None:
    whole = table.read_text()
    table.write_text("gripper: [")
    built = GraspEditor(BRACKET, JAW, table, port=0)
    try:
        assert "cannot be edited" in shown(built) and "valid YAML" in shown(built)
        built.act("add")
        built.act("save")
        assert table.read_text() == "gripper: ["
        table.write_text(whole)
        soon(lambda: built.point is not None)
        assert built.document.text == whole
    finally:
        built.close()


def broken_while_edited(editor: GraspEditor, table: Path) -> tuple[str, str]:
    """The file's text before another program broke it, and what is being edited in the page since."""
    whole = table.read_text()
    table.write_text("gripper: [")
    soon(lambda: "correct the syntax there. Correct it" in shown(editor))
    editor.act("on / off")
    return whole, editor.document.text


def test_a_file_mended_to_what_it_was_is_edited_on_and_the_complaint_goes(editor: GraspEditor, table: Path) -> None:
    whole, mine = broken_while_edited(editor, table)
    table.write_text(whole)
    soon(lambda: "can be read again" in shown(editor))
    assert "cannot be edited" not in shown(editor) and editor.document.text == mine
    editor.act("save")
    assert table.read_text() == mine


def test_a_file_mended_to_something_else_asks_what_is_to_stay(editor: GraspEditor, table: Path) -> None:
    """It was read again, and what was being edited was gone from the page."""
    whole, mine = broken_while_edited(editor, table)
    table.write_text(whole.replace("width: 0.012", "width: 0.0125"))
    soon(lambda: "0.0125" in shown(editor) and editor._panel._conflict.visible)
    assert editor.document.text == mine and "cannot be edited" not in shown(editor)
    editor.act("overwrite")
    assert table.read_text() == mine and not editor._panel._conflict.visible


def test_a_file_that_cannot_be_read_for_a_while_is_watched_on(editor: GraspEditor, table: Path) -> None:
    whole = table.read_text()
    editor.act("on / off")
    table.unlink()
    table.mkdir()
    soon(lambda: "Is a directory" in shown(editor))
    editor.act("save")
    editor.act("overwrite")
    assert table.is_dir() and "Is a directory" in shown(editor)
    table.rmdir()
    table.write_text(whole.replace("width: 0.012", "width: 0.0125"))
    editor.act("save")
    assert "0.0125" in shown(editor)
    assert all(thread.is_alive() for thread in editor._threads)


def test_undo_stays_at_the_grasp_that_is_edited(editor: GraspEditor) -> None:
    """After Down and Undo another grasp was under the cursor, and got what was typed next."""
    edited = editor.document.points[0]
    editor.act("down")
    assert editor.point == edited
    editor.act("undo")
    assert editor.point == edited and editor.selected == 0
    editor.act("redo")
    assert editor.point == edited and editor.selected == 1


def test_a_button_says_what_it_did_where_nothing_moves(editor: GraspEditor) -> None:
    editor.act("undo")
    assert "nothing to undo" in shown(editor)
    editor.act("redo")
    assert "nothing to redo" in shown(editor)
    editor.act("down")
    assert f"is number 2 of {len(editor.document.points)}" in shown(editor)
    editor.act("undo")
    assert "nothing" not in shown(editor)


def test_the_terminal_names_one_address(table: Path, capsys: pytest.CaptureFixture[str]) -> None:
    built = GraspEditor(BRACKET, JAW, table, port=0, host="0.0.0.0", token="one of a user's own")
    try:
        assert "http" not in capsys.readouterr().out  # the caller prints `url`
        assert "0.0.0.0" not in built.url and built.url.endswith("/?token=one%20of%20a%20user%27s%20own")
    finally:
        built.close()


def test_the_page_asks_for_its_token_on_this_machine_too(editor: GraspEditor) -> None:
    with pytest.raises(HTTPError, match="403"):
        urlopen(editor.url.partition("?")[0])


def test_a_symmetric_workpiece_shows_its_axes() -> None:
    screw = load_workpiece("ring_screw")
    built = GraspEditor(screw, load_gripper("jaw_v_rod"), screw.folder / "grasps.yaml", port=0)
    try:
        axes = [i for i in range(3) if screw.symmetry.degrees[i] > 0]
        scene = built._server.scene
        assert axes and all(scene.get_handle_by_name(f"/part/symmetry/{'xyz'[i]}") is not None for i in axes)
    finally:
        built.close()


def test_films_show_the_slip_that_the_trial_measured() -> None:
    cell = TrialCell(BRACKET, JAW)
    try:
        T = cell.resting_poses()[0]
        outcome = try_free(cell, T, read_table(BRACKET.folder / "grasps.yaml").grasps[0])
    finally:
        cell.close()
    assert outcome.held and outcome.film is not None
    assert outcome.film.slip(0, BRACKET.com) == pytest.approx(outcome.slip, abs=5e-5)
    lifted = outcome.film.Ts_world_part[-1, 0, 2, 3] - outcome.film.Ts_world_part[0, 0, 2, 3]
    assert lifted == pytest.approx(0.10, abs=0.005)


def test_the_heap_is_the_same_before_every_try() -> None:
    points = read_table(BRACKET.folder / "grasps.yaml").grasps
    heap = HeapCell(BRACKET, JAW, seed=0)
    try:
        first, _, again = (heap.try_grasp(p) for p in (points[0], points[1], points[0]))
    finally:
        heap.close()
    assert first.film is not None and again.film is not None
    np.testing.assert_allclose(first.film.Ts_world_part[0], again.film.Ts_world_part[0], atol=2e-4)
    assert (first.held, first.reason) == (again.held, again.reason)


def drawn(browser: Browser) -> None:
    """Wait until the page has been drawn three times: what it was sent has reached the scene by then."""
    frame = "new Promise(done => requestAnimationFrame(done))"
    for _ in range(3):
        browser.run(frame)


def press(browser: Browser, label: str) -> None:
    """Click a button by its text, once it can be."""
    find = f"[...document.querySelectorAll('button')].find(e => e.innerText.trim() === '{label}' && !e.disabled)"
    browser.until(find, PATIENCE)
    browser.run(f"{find}.click()")


def open_tab(browser: Browser, title: str) -> None:
    """Bring a tab to the front; it listens to the mouse, not to clicks by script."""
    tab = f"document.querySelector('[role=tab][title={title}]')"
    browser.until(tab, PATIENCE)
    place = f"(() => {{ const r = {tab}.getBoundingClientRect(); return [r.x + r.width / 2, r.y + 8]; }})()"

    def selected() -> bool:
        browser.click(*browser.run(place))  # again where the page has just moved it
        drawn(browser)
        return bool(browser.run(f"{tab}.ariaSelected === 'true'"))

    soon(selected)


def write(browser: Browser, label: str, value: Any) -> None:
    """Type into the widget beside a label."""
    browser.until(f"[...document.querySelectorAll('label')].some(e => e.innerText.trim() === '{label}')", PATIENCE)
    browser.run(
        f"""(() => {{
        const label = [...document.querySelectorAll('label')].find(e => e.innerText.trim() === '{label}');
        let box = label; while (!box.querySelector('input')) box = box.parentElement;
        const input = box.querySelector('input');
        const set = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set;
        input.focus(); set.call(input, '{value}');
        input.dispatchEvent(new Event('input', {{bubbles: true}})); input.blur();
        }})()"""
    )


def drag_handle(browser: Browser, editor: GraspEditor, axis: int) -> None:
    """Drag the handle by the mouse along one of its arrows, outwards."""
    camera = next(iter(editor._server.get_clients().values())).camera
    R = from_quat_xyzw((0, 0, 0), np.roll(camera.wxyz, -1))[:3, :3]
    f = camera.image_height / 2 / np.tan(camera.fov / 2)

    def pixel(point: np.ndarray) -> tuple[float, float]:
        x, y, z = R.T @ (point - camera.position)
        return camera.image_width / 2 + f * x / z, camera.image_height / 2 + f * y / z

    T, arrow = frame_of(editor.document.points[0]), editor._scene.handle.scale
    stops = [pixel(T[:3, 3] + share * arrow * T[:3, axis]) for share in (0.7, 0.8, 0.9, 1.0)]
    for k, (x, y) in enumerate(stops):
        browser.send("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y, button="left", buttons=int(k > 0))
        drawn(browser)
        if k == 0:
            browser.send("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, button="left", clickCount=1)
            drawn(browser)
    browser.send("Input.dispatchMouseEvent", type="mouseReleased", x=x, y=y, button="left", clickCount=1)


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")
def test_open_move_try_save_reopen_in_a_browser(editor: GraspEditor, table: Path, tmp_path: Path) -> None:
    comments = [line.partition("#")[2] for line in table.read_text().splitlines() if "#" in line]
    with Browser(tmp_path, 800, 600) as browser:
        browser.open(editor.url)
        browser.until(
            "document.body.innerText.includes('234 of its 234 poses are free of collisions with the part')", PATIENCE
        )
        browser.picture(tmp_path / "page.png")  # once it is drawn, the mouse finds something
        drag_handle(browser, editor, 1)
        soon(lambda: editor.document.changed)
        dragged = np.subtract(editor.document.points[0].centre, (0.007, 0.0, -0.0045))
        assert dragged[0] > 0.003 and abs(dragged[1]) < 1e-5 and abs(dragged[2]) < 1e-5  # along its arrow alone
        open_tab(browser, "Fields")
        write(browser, "name", "from_the_top")
        write(browser, "centre [mm]", "9")
        soon(lambda: editor.document.points[0].name == "from_the_top" and editor.document.points[0].centre[0] == 0.009)
        write(browser, "depths [mm]", "3 x")
        browser.until("document.body.innerText.includes('Not taken')", PATIENCE)
        open_tab(browser, "Try")
        press(browser, "Try this grasp")
        browser.until("document.body.innerText.includes('holds, slips')", PATIENCE)
        open_tab(browser, "Save")
        assert table.read_text().count("from_the_top") == 0
        press(browser, "Show changes")
        browser.until("document.body.innerText.includes('from_the_top')", PATIENCE)
        press(browser, "Write the file")
        soon(lambda: not editor.document.changed)
        assert browser.errors == []
        own = (editor.url.partition("?")[0], "data:", "blob:", "ws:", "about:")
        outside = [u for u in browser.requests if not u.startswith(own)]
        assert outside == []
    saved = read_table(table).grasps[0]
    assert (saved.name, saved.centre) == ("from_the_top", (0.009, 0.0, -0.0045))
    assert [line.partition("#")[2] for line in table.read_text().splitlines() if "#" in line] == comments
    again = GraspEditor(BRACKET, JAW, table, port=0)
    try:
        assert again.point == saved and not again.document.changed
    finally:
        again.close()
