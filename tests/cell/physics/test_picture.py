"""Pictures for reports."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pickproof.cell.frames import make_transform
from pickproof.cell.geometry.bin import table
from pickproof.cell.physics.picture import BACKGROUND, cell_picture
from pickproof.cell.physics.world import World
from pickproof.cell.workpiece.workpiece import Workpiece


def test_a_picture_shows_table_part_and_background(new_world: Callable[..., World], bracket: Workpiece) -> None:
    world = new_world()
    world.add_box(table((0.4, 0.4, 0.02), (0.0, 0.0, 0.0)))
    empty = cell_picture(world, (0.4, -0.4, 0.3), (0.0, 0.0, 0.0), 120, 90)
    world.add_part(bracket, make_transform(t=(0.0, 0.0, 0.007)))
    image = cell_picture(world, (0.4, -0.4, 0.3), (0.0, 0.0, 0.0), 120, 90)
    assert image.shape == (90, 120, 3) and image.dtype == np.uint8
    np.testing.assert_array_equal(image[0, 0], np.rint(np.multiply(BACKGROUND, 255)))
    changed = np.argwhere((image != empty).any(axis=-1))
    assert 20 < len(changed) < 2000
    assert np.abs(np.median(changed, axis=0) - (45, 60)).max() < 12
