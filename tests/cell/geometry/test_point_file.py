from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from pickproof.cell.errors import InputError
from pickproof.cell.frames import about_axis
from pickproof.cell.geometry.point_file import read_point_file, sensor_pose

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


def declaring(count: int, name: str) -> bytes:
    """A file of three points that declares `count`."""
    body = "".join(" ".join(map(str, p)) + "\n" for p in POINTS).encode()
    packed = POINTS.astype("<f4").tobytes()
    ply = f"element vertex {count}\nproperty float x\nproperty float y\nproperty float z\n"
    faces = "element face 1\nproperty list uchar int vertex_indices\n"
    pcd = PCD.replace("WIDTH 4", f"WIDTH {count}").replace("POINTS 4", f"POINTS {count}")
    return {
        "ascii.ply": f"ply\nformat ascii 1.0\n{ply}end_header\n".encode() + body,
        "binary.ply": f"ply\nformat binary_little_endian 1.0\n{ply}end_header\n".encode() + packed,
        "faces.ply": f"ply\nformat ascii 1.0\n{ply}{faces}end_header\n".encode() + body + b"3 0 1 2\n",
        "ascii.pcd": pcd.encode() + body,
        "binary.pcd": pcd.replace("ascii", "binary").encode() + packed,
        "counted.pts": f"{count}\n".encode() + body,
    }[name]


@pytest.mark.parametrize("name", ["ascii.ply", "binary.ply", "faces.ply", "ascii.pcd", "binary.pcd", "counted.pts"])
def test_a_cloud_that_was_cut_is_refused_with_both_counts(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(declaring(3, name))
    np.testing.assert_allclose(read_point_file(path), POINTS, atol=1e-6)
    path.write_bytes(declaring(7, name))
    with pytest.raises(InputError, match=rf"{name}.*3 in the file.*7 as its header declares"):
        if name != "faces.ply":
            read_point_file(path)
        else:  # the line of the face is no row of a vertex
            path.write_bytes(declaring(7, name).replace(b"3 0 1 2\n", b""))
            read_point_file(path)
    if "faces" not in name:
        path.write_bytes(declaring(2, name))
        with pytest.raises(InputError, match=r"3 in the file.*2 as its header declares"):
            read_point_file(path)


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("0.1 0.2 0.3\n0.1 0.2\n0.1 0.2 0.4\n", "row 2 of 2 numbers among rows of 3"),
        ("0,1 0,2 0,3\n0,1 0,2 0,4\n", "','"),
        ("0.1 0.2 0.3\n0.1 0.2", "1 in the file"),
    ],
)
def test_rows_that_are_not_alike(tmp_path: Path, text: str, names: str) -> None:
    (tmp_path / "cloud.xyz").write_text(text)
    with pytest.raises(InputError, match=names):
        read_point_file(tmp_path / "cloud.xyz")


def test_the_viewpoint_of_a_pcd_file(tmp_path: Path) -> None:
    path = tmp_path / "cloud.pcd"
    write(path)
    assert sensor_pose(path) is None
    turned = about_axis((1.0, 0.0, 0.0), np.pi)
    turned[:3, 3] = 0.4, -0.1, 0.9
    path.write_text(PCD.replace("VIEWPOINT 0 0 0 1 0 0 0", "VIEWPOINT 0.4 -0.1 0.9 0 1 0 0"))
    np.testing.assert_allclose(sensor_pose(path), turned, atol=1e-12)
    for words in ("0 0 0 1 0 0", "0 0 0 2 0 0 0", "0 0 0 a b c d", "nan 0 0 1 0 0 0"):
        path.write_text(PCD.replace("0 0 0 1 0 0 0", words))
        with pytest.raises(InputError, match=r"VIEWPOINT.*w x y z"):
            sensor_pose(path)


def test_doubles_in_a_binary_pcd_are_named(tmp_path: Path) -> None:
    head = PCD.replace("4", "3").replace("SIZE 3 3 3", "SIZE 8 8 8").replace("ascii", "binary")
    (tmp_path / "cloud.pcd").write_bytes(head.encode() + POINTS.astype("<f8").tobytes())
    with pytest.raises(InputError, match="SIZE 8 and TYPE F, not of 4 and F"):
        read_point_file(tmp_path / "cloud.pcd")
