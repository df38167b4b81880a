"""A grasps.yaml edited by a program: what is not meant stays to the letter, and nobody's work is lost."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from pickproof.cell.errors import InputError
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from pickproof.grasping.grasp_points import read_table
from pickproof.scenarios.grasp_editor.document import Conflict, GraspDocument, Saved, begun_point

pytestmark = pytest.mark.slow

COMMENTED = """\
# The head of the file.
gripper: jaw_v1   # the small one

grasps:
  # over the first
  - name: first # beside the first
    centre: [0.0070, 0, -0.00450]
    approach: [0, 0, -1]
    closing: [0, 1, 0]
    # between two fields
    width: 0.018
    depths:
      - 0.005
      - 1.5e-3

  # over the second
  # in two lines
  - {name: second, centre: [0, 0, 0], approach: [0, 0, -1], closing: [1, 0, 0], width: 0.008}
  - name: "third"
    centre: &c [0.0, 0.0, 0.0]
    approach: [0, 0, 1]
    closing: [0, 1, 0]
    width: 0.018
    tool_rotation: {from_deg: -30, to_deg: 30} # a range
    # the end of the third
# the end of the file
"""
BRACKET, JAW = load_workpiece("bracket"), load_gripper("jaw_v1")


@pytest.fixture
def document(tmp_path: Path) -> GraspDocument:
    path = tmp_path / "grasps.yaml"
    path.write_text(COMMENTED, encoding="utf-8")
    return GraspDocument(path, BRACKET, JAW)


def comments(text: str) -> list[str]:
    return [line.partition("#")[2].strip() for line in text.splitlines() if "#" in line]


def changed_lines(document: GraspDocument) -> list[str]:
    return [line for line in document.diff().splitlines()[2:] if line[0] in "+-"]


def test_setting_a_field_changes_its_line_alone(document: GraspDocument) -> None:
    document.change(0, {"centre": (0.001, 0.0, 5e-6), "width": 0.018})
    assert changed_lines(document) == [
        "-    centre: [0.0070, 0, -0.00450]",
        "+    centre: [0.001, 0.0, 0.000005]",
    ]
    document.change(2, {"tool_rotation": {"from_deg": -10.0, "to_deg": 30.0, "step_deg": 5.0}})
    assert "tool_rotation: {from_deg: -10.0, to_deg: 30.0, step_deg: 5.0} # a range" in document.text
    document.change(1, {"priority": 0.5})
    assert document.points[1].priority == 0.5
    assert comments(document.text) == comments(COMMENTED)


def test_numbers_are_read_back_as_they_were_set(document: GraspDocument) -> None:
    """Also small ones: YAML 1.1 takes 1e-06 for a string."""
    rng = np.random.default_rng(0)
    for scale in (1e-6, 1e-3, 1.0):
        centre = tuple(np.round(rng.uniform(-scale, scale, 3), 9).tolist())
        document.change(1, {"centre": centre})
        raw = yaml.safe_load(document.text)["grasps"][1]["centre"]
        assert all(isinstance(v, float) for v in raw)
        assert document.points[1].centre == pytest.approx(centre, abs=1e-12)


def test_a_field_taken_out_keeps_the_comments_around_it(document: GraspDocument) -> None:
    document.change(2, {"tool_rotation": None})
    assert "tool_rotation" not in document.text
    assert "# the end of the third" in document.text and "# the end of the file" in document.text
    document.change(0, {"opening": None})  # was not there
    assert len(changed_lines(document)) == 1


def test_entries_move_with_their_comments_and_go_with_them(document: GraspDocument) -> None:
    document.move(1, 0)
    assert [p.name for p in document.points] == ["second", "first", "third"]
    assert document.text.index("# over the second") < document.text.index("name: second")
    assert document.text.index("# over the first") < document.text.index("name: first")
    assert sorted(comments(document.text)) == sorted(comments(COMMENTED))
    document.undo()
    assert document.text == COMMENTED
    document.remove(0)
    assert {"over the first", "beside the first", "between two fields"}.isdisjoint(comments(document.text))
    assert {"over the second", "in two lines", "the end of the file"} <= set(comments(document.text))


def test_any_run_of_edits_is_undone_to_the_letter_and_redone(document: GraspDocument) -> None:
    rng = np.random.default_rng(3)
    texts = [document.text]
    for _ in range(25):
        i, n = int(rng.integers(len(document.points))), len(document.points)
        kind = rng.integers(4)
        if kind == 0:
            document.change(i, {"priority": round(float(rng.uniform()), 3)})
        elif kind == 1:
            document.add(begun_point(BRACKET, JAW, document.free_name("new")), i)
        elif kind == 2:
            document.move(i, int(rng.integers(n)))
        elif n > 1:
            document.remove(i)
        if document.text != texts[-1]:
            texts.append(document.text)
    for text in reversed(texts[:-1]):
        document.undo()
        assert document.text == text
    assert not document.can_undo and document.text == COMMENTED
    for text in texts[1:]:
        document.redo()
        assert document.text == text


@pytest.mark.parametrize("name", ["bracket", "bunny", "gear_shaft", "ps6d_23"])  # each laid out in its own way
def test_shipped_tables_come_back_to_the_letter(name: str, tmp_path: Path) -> None:
    workpiece: Workpiece = load_workpiece(name)
    path = tmp_path / "grasps.yaml"
    shutil.copy(workpiece.folder / "grasps.yaml", path)
    gripper = load_gripper(read_table(path).gripper)
    document = GraspDocument(path, workpiece, gripper)
    text = document.text
    document.change(0, {"priority": 0.123})
    assert 1 <= len(changed_lines(document)) <= 2
    edited, last = document.text, len(document.points) - 1
    document.add(document.points[0].model_copy(update={"name": "another"}), 0)
    document.remove(1)
    document.move(0, last)
    document.move(last, 0)
    assert document.text == edited and document.save() == Saved()
    assert read_table(path).grasps[0].priority == 0.123
    while document.can_undo:
        document.undo()
    assert document.text == text


@pytest.mark.parametrize(
    ("index", "fields", "said"),
    [
        (0, {"width": -1.0}, "width"),
        (0, {"opening": 0.001}, "opening"),
        (0, {"opening": 0.2}, "at most 0.06"),
        (0, {"name": "second"}, "a name that no other grasp point has"),
        (0, {"closing": [0, 0, 1]}, "right angles"),
        (0, {"name": ""}, "name"),
    ],
)
def test_what_does_not_fit_is_refused_and_changes_nothing(
    document: GraspDocument, index: int, fields: dict[str, object], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        document.change(index, fields)
    assert document.text == COMMENTED and not document.can_undo


def test_the_last_grasp_stays(document: GraspDocument) -> None:
    document.remove(0)
    document.remove(0)
    with pytest.raises(InputError, match="at least one"):
        document.remove(0)


def test_of_two_concurrent_edits_neither_is_lost(tmp_path: Path) -> None:
    path = tmp_path / "grasps.yaml"
    path.write_text(COMMENTED, encoding="utf-8")
    mine, theirs = (GraspDocument(path, BRACKET, JAW) for _ in range(2))
    mine.change(0, {"priority": 0.1})
    theirs.change(1, {"priority": 0.2})
    assert theirs.save() == Saved() and mine.changed_outside()
    result = mine.save()
    assert isinstance(result, Conflict) and "priority: 0.2" in result.diff
    assert path.read_text(encoding="utf-8") == theirs.text  # nothing was written
    kept = mine.save(overwrite=True)
    assert isinstance(kept, Saved) and kept.kept is not None
    assert path.read_text(encoding="utf-8") == mine.text
    assert kept.kept.read_text(encoding="utf-8") == theirs.text
    theirs.change(1, {"priority": 0.3})
    edited = theirs.text
    theirs.reload()
    assert theirs.text == mine.text
    theirs.undo()
    assert theirs.text == edited and theirs.changed  # what was being edited is one step away


@pytest.mark.parametrize("broken", ["gripper: [", "gripper: jaw_v1\n", "- a\n", "gripper: a\ngripper: b\ngrasps: 3\n"])
def test_a_broken_file_is_named_and_never_written_over(broken: str, tmp_path: Path) -> None:
    path = tmp_path / "grasps.yaml"
    path.write_text(broken, encoding="utf-8")
    fresh = GraspDocument(path, BRACKET, JAW)
    assert str(path) in fresh.error and fresh.points == ()
    with pytest.raises(InputError):
        fresh.save(overwrite=True)
    path.write_text(COMMENTED, encoding="utf-8")
    fresh.reload()
    assert fresh.error == "" and len(fresh.points) == 3
    fresh.change(0, {"priority": 0.5})
    path.write_text(broken, encoding="utf-8")  # broken while it was being edited
    assert isinstance(fresh.save(), Conflict)
    with pytest.raises(InputError):
        fresh.save(overwrite=True)
    assert path.read_text(encoding="utf-8") == broken


def test_a_table_is_begun_where_there_is_none(tmp_path: Path) -> None:
    path = tmp_path / "grasps.yaml"
    document = GraspDocument(path, BRACKET, JAW)
    assert document.changed and not path.exists() and "+gripper: jaw_v1" in document.diff()
    assert document.save() == Saved() and read_table(path).gripper == "jaw_v1"
    assert not document.changed


def test_links_and_rights_of_the_file_stay(tmp_path: Path) -> None:
    real, link = tmp_path / "real.yaml", tmp_path / "grasps.yaml"
    real.write_text(COMMENTED, encoding="utf-8")
    real.chmod(0o640)
    link.symlink_to(real)
    document = GraspDocument(link, BRACKET, JAW)
    document.change(0, {"priority": 0.1})
    document.save()
    assert link.is_symlink() and real.read_text(encoding="utf-8") == document.text
    assert real.stat().st_mode & 0o777 == 0o640
