"""The gallery of camera classes."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from pickproof.perception.data.scenes import HELD_OUT_SEED
from pickproof.perception.evaluation.sensor_gallery import CASES, MISSING, draw_gallery
from tests.perception.small_heaps import bracket, fill_folder


@pytest.mark.slow
def test_the_exact_picture_misses_nothing_and_the_others_do(tmp_path: Path) -> None:
    fill_folder(tmp_path, HELD_OUT_SEED, 1)
    draw_gallery(bracket(), tmp_path, tmp_path / "gallery.png")
    picture = cv2.imread(str(tmp_path / "gallery.png"))
    assert picture is not None
    red = np.abs(picture[..., ::-1] - 255 * np.array(MISSING)).max(axis=-1) < 3
    columns = [part.mean() for part in np.array_split(red, len(CASES), axis=1)]
    assert columns[0] == 0
    assert min(columns[1:]) > 0.02
    assert columns[2] > columns[1] and columns[3] > columns[1]  # polished and black lose more than matt
