"""A real part is not its CAD: how much it may deviate enters what counts as lying on it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from pickproof.cell.child_process import FOLDERS
from pickproof.cell.errors import InputError
from pickproof.cell.workpiece.workpiece import FORM_TOLERANCES, load_workpiece
from pickproof.perception.cad.shape_model import ShapeModel

pytestmark = pytest.mark.slow


def written(folder: Path, **fields: object) -> None:
    """A copy of the bracket with other fields, as `part`."""
    shipped = load_workpiece("bracket").folder
    data = YAML(typ="safe").load((shipped / "workpiece.yaml").read_text()) | {"name": "part"} | fields
    (folder / "part").mkdir()
    (folder / "part" / "bracket.ply").write_bytes((shipped / "bracket.ply").read_bytes())
    with (folder / "part" / "workpiece.yaml").open("w") as file:
        YAML().dump(data, file)


@pytest.mark.parametrize(
    ("fields", "tolerance"),
    [
        ({}, 0.0),
        ({"process": "printed"}, FORM_TOLERANCES["printed"]),
        ({"process": "cast"}, FORM_TOLERANCES["cast"]),
        ({"process": "cast", "form_tolerance": 0.0002}, 0.0002),
        ({"process": "cast", "form_tolerance": 0.0}, 0.0),
    ],
)
def test_it_is_told_or_that_of_the_process(tmp_path, monkeypatch, fields, tolerance):
    written(tmp_path, **fields)
    monkeypatch.setenv(FOLDERS, str(tmp_path))
    assert load_workpiece("part").form_tolerance == tolerance


def test_an_unknown_process_is_named(tmp_path, monkeypatch):
    written(tmp_path, process="forged")
    monkeypatch.setenv(FOLDERS, str(tmp_path))
    with pytest.raises(InputError) as error:
        load_workpiece("part")
    assert "process" in str(error.value) and "'cast'" in str(error.value)


def test_it_adds_to_the_noise_of_the_camera():
    bracket = load_workpiece("bracket")
    assert ShapeModel.of(bracket).deviation(1.2e-4) == 1.2e-4
    printed = ShapeModel.of(replace(bracket, form_tolerance=3e-4))
    np.testing.assert_allclose(printed.deviation(4e-4), 5e-4)
