from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from cell.errors import InputError
from cell.point_file import read_point_file

POINTS = np.array([[0.1, -0.2, 0.9], [0.125, 0.0, 1.0], [-0.5, 0.25, 0.75]])
PCD = """VERSION .7
FIELDS x y z
SIZE 4 4 4
TYPE F F F
COUNT 1 1 1
WIDTH 4
HEIGHT 1
VIEWPOINT 0 0 0 1 0 0 0
POINTS 4
DATA ascii
"""


def write(path: Path) -> None:
    rows = "\n".join(" ".join(map(str, p)) for p in POINTS)
    if path.suffix == ".pcd":
        path.write_text(PCD + rows + "\nnan nan nan\n")
    elif path.suffix == ".ply":
        trimesh.PointCloud(POINTS).export(path)
    else:
        path.write_text(rows + "\n")


@pytest.mark.parametrize("name", ["cloud.ply", "cloud.pcd", "cloud.xyz"])
def test_points_are_read_and_what_is_not_finite_is_left_out(tmp_path: Path, name: str) -> None:
    write(tmp_path / name)
    np.testing.assert_allclose(read_point_file(tmp_path / name), POINTS, atol=1e-7)


@pytest.mark.parametrize("name", ["cloud.ply", "cloud.pcd", "cloud.xyz"])
def test_what_is_no_cloud_is_named(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=rf"{name}.*missing"):
        read_point_file(tmp_path / name)
    (tmp_path / name).write_text("not a cloud at all\n")
    with pytest.raises(InputError, match=rf"{name}.*a point cloud with points"):
        read_point_file(tmp_path / name)
