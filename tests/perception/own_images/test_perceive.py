"""`pickproof perceive` on files of one measured scene: as a depth image and as clouds, against the same in memory."""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from pickproof.cell.frames import Array, about_axis, apply, invert, make_transform
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.cell.sensing.sensor_model import measure
from pickproof.perception.data.region import region_of_interest
from pickproof.perception.data.scenes import heap_bin, render_heap, tilted_view
from pickproof.perception.estimate import Perception
from pickproof.perception.evaluation.metrics import score_frame, visible_instances
from pickproof.scenarios.commands.cli import main
from tests.perception.small_heaps import bracket, small_heaps

pytestmark = pytest.mark.slow

STEP_MM = 0.05
AWRY = about_axis(np.array([1.0, 2.0, 3.0]) / np.sqrt(14), 0.06)
"""T of a cloud that lies on no pixel grid: turned about the camera's centre."""


@lru_cache
def seen(heap: int = 0) -> tuple[DepthFrame, Array, np.ndarray]:
    """A measured frame of a heap, the true poses in the camera, and which workpieces are well visible."""
    view, Ts = tilted_view(bracket(), np.random.default_rng(4)), small_heaps()[heap]
    exact = render_heap(bracket(), Ts, view)
    frame = measure(exact, view.intrinsics, view.T_world_camera, view.sensor, np.random.default_rng(0))
    counted = visible_instances(np.bincount(exact.ids[exact.ids >= 0], minlength=len(Ts)))
    return frame, invert(view.T_world_camera) @ Ts, counted


@lru_cache
def in_memory(heap: int = 0) -> Array:
    frame, rng = seen(heap)[0], np.random.default_rng(0)
    found = Perception.load(bracket()).perceive_region(frame, region_of_interest(frame, bracket()), rng).estimates
    return np.array([e.T_camera_part for e in found])


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Files of the first scene."""
    monkeypatch.chdir(tmp_path)
    write_files(0)
    return tmp_path


def write_files(heap: int) -> None:
    frame = seen(heap)[0]
    points = frame.points_camera()[0]
    K = frame.intrinsics
    cv2.imwrite("depth.png", np.rint(1000 * frame.depth / STEP_MM).astype(np.uint16))
    cam_K = [K.fx, 0, K.cx, 0, K.fy, K.cy, 0, 0, 1]
    Path("camera.json").write_text(json.dumps({"cam_K": cam_K, "depth_scale": STEP_MM}))
    trimesh.PointCloud(1000 * points).export("cloud.ply")
    np.save("awry.npy", apply(AWRY, points))
    np.savez("organised.npz", points=np.where(frame.depth[..., None] > 0, K.rays() * frame.depth[..., None], np.nan))


def perceived(*words: str) -> Array:
    assert main(["perceive", "bracket", *words]) == 0
    document = json.loads(Path("out/perceive/bracket/poses.json").read_text())
    picture = cv2.imread("out/perceive/bracket/poses.png")
    assert picture is not None and picture.shape[1] >= 1000 and picture.std() > 10
    return np.array([pose["T_camera_workpiece"] for pose in document["poses"]])


def mean_gap(found: Array, wanted: Array) -> Array:
    """(n,) [m] distance of each wanted pose to the nearest one found, over corners of the bracket."""
    corners = bracket().vertices[::5]
    gaps = np.linalg.norm(apply(found, corners)[None] - apply(wanted, corners)[:, None], axis=-1)
    return gaps.mean(-1).min(1)


def test_an_image_and_a_cloud_give_the_poses_of_the_frame_in_memory(here: Path) -> None:
    """Up to the rounding of the files, which lets ICP start elsewhere and a hardly visible workpiece come or go."""
    gaps: dict[str, list[Array]] = {"image": [], "cloud": []}
    for heap in range(3):
        _, truth, counted = seen(heap)
        assert score_frame(in_memory(heap), truth, counted, bracket()).true_positives >= 0.8 * counted.sum()
        write_files(heap)
        by_image = perceived("depth.png", "--camera", "camera.json")
        by_cloud = perceived("cloud.ply", "--unit", "mm")
        for kind, found in (("image", by_image), ("cloud", by_cloud)):
            assert abs(len(found) - len(in_memory(heap))) <= 1
            gaps[kind].append(mean_gap(found, in_memory(heap)))
    for of_kind in gaps.values():
        gap = np.concatenate(of_kind)
        assert np.median(gap) < 1.5e-4
        assert np.mean(gap < bracket().tolerance / 10) >= 0.9  # all but one of a heap


def test_a_cloud_without_a_pixel_grid(here: Path) -> None:
    """The camera's pose puts it right: poses in the cloud's own frame are those of the camera, turned."""
    Path("pose.txt").write_text("\n".join(" ".join(map(str, row)) for row in AWRY))
    found = perceived("awry.npy", "--camera-pose", "pose.txt")
    assert np.median(mean_gap(found, in_memory())) < 2e-4  # the grid is found again
    document = json.loads(Path("out/perceive/bracket/poses.json").read_text())
    world = np.array([pose["T_world_workpiece"] for pose in document["poses"]])
    np.testing.assert_allclose(world, AWRY @ found, atol=1e-9)
    unaware = perceived("awry.npy")  # as if the camera had stood so: no grid
    truth, counted = AWRY @ seen()[1], seen()[2]
    score = score_frame(unaware, truth, counted, bracket())
    assert score.true_positives >= 0.8 * counted.sum()
    assert np.median(score.distances) < 0.0005


def test_a_bin_and_a_box_say_where(here: Path) -> None:
    frame = seen()[0]
    T = invert(frame.T_world_camera) @ heap_bin(bracket()).T_world_bin
    document = {"inner": list(heap_bin(bracket()).inner), "T_world_bin": T.tolist()}
    Path("bin.yaml").write_text(json.dumps(document))
    in_bin = perceived("organised.npz", "--bin", "bin.yaml")
    assert np.median(mean_gap(in_bin, in_memory())) < 5e-4
    nearest = in_memory()[0, :3, 3]  # of the box around one of them
    box = [str(x) for x in (*(nearest - 0.035), *(nearest + 0.035))]
    found = perceived("organised.npz", "--roi", *box)
    assert 0 < len(found) < len(in_memory())
    assert (np.abs(found[:, :3, 3] - nearest) < 0.035 + 0.02).all()


def test_ray_length_is_named_and_converted(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frame = seen()[0]
    length = np.linalg.norm(frame.intrinsics.rays(), axis=-1)
    cv2.imwrite("range.png", np.rint(1000 * frame.depth * length / STEP_MM).astype(np.uint16))
    found = perceived("range.png", "--camera", "camera.json", "--depth-is", "range")
    assert np.median(mean_gap(found, in_memory())) < 2e-4
    assert capsys.readouterr().err == ""
    perceived("range.png", "--camera", "camera.json")
    warning = capsys.readouterr().err
    assert warning.startswith("pickproof: warning: ") and warning.count("\n") == 1 and "--depth-is range" in warning
    perceived("depth.png", "--camera", "camera.json")
    assert capsys.readouterr().err == ""


def test_the_viewpoint_of_a_cloud_in_the_world(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Points in the frame of a table, seen from above: VIEWPOINT says from where, and --camera-pose before it."""
    T = about_axis((1.0, 0.0, 0.0), np.pi)
    T[:3, 3] = 0.4, -0.1, 0.9
    points = apply(T, seen()[0].points_camera()[0])
    head = f"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {len(points)}\nHEIGHT 1\n"
    head += f"VIEWPOINT 0.4 -0.1 0.9 0 1 0 0\nPOINTS {len(points)}\nDATA binary\n"
    Path("world.pcd").write_bytes(head.encode() + points.astype("<f4").tobytes())
    found = perceived("world.pcd")
    assert np.median(mean_gap(found, in_memory())) < 2e-4
    document = json.loads(Path("out/perceive/bracket/poses.json").read_text())
    np.testing.assert_allclose(document["camera"]["T_world_camera"], T, atol=1e-9)
    in_camera = seen()[0].points_camera()[0]  # as programs write it that keep points in the sensor's frame
    Path("sensor.pcd").write_bytes(head.encode() + in_camera.astype("<f4").tobytes())
    assert main(["perceive", "bracket", "sensor.pcd"]) == 2
    assert "VIEWPOINT" in (error := capsys.readouterr().err) and "--camera-pose" in error
    np.savetxt("pose.txt", np.eye(4))
    assert len(perceived("sensor.pcd", "--camera-pose", "pose.txt")) == len(in_memory())


def test_no_workpiece_is_an_answer(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    v, u = np.mgrid[:240, :320]
    ball = 0.08**2 - ((u - 160) / 400) ** 2 - ((v - 120) / 400) ** 2
    np.save("ball.npy", np.where(ball > 0, 0.8 - np.sqrt(np.maximum(ball, 0)), 0.9))
    words = ["--fx", "400", "--fy", "400", "--cx", "160", "--cy", "120", "--json"]
    assert main(["perceive", "bracket", "ball.npy", *words]) == 0
    assert json.loads(capsys.readouterr().out)["poses"] == []


def bad_files() -> None:
    depth = seen()[0].depth
    points = seen()[0].points_camera()[0]
    cv2.imwrite("eight.png", np.full((480, 640), 200, np.uint8))
    cv2.imwrite("small.png", np.full((240, 320), 900, np.uint16))
    cv2.imwrite("black.png", np.zeros((480, 640), np.uint16))
    Path("text.png").write_text("no picture")
    Path("text.ply").write_text("no cloud")
    np.save("nan.npy", np.full((500, 3), np.nan))
    np.save("empty.npy", np.zeros((0, 3)))
    np.save("behind.npy", points * [1, 1, -1])
    np.save("metres.npy", depth)
    np.save("words.npy", np.array(["a", "b"]))
    K = seen()[0].intrinsics
    sized = {"fx": K.fx, "fy": K.fy, "cx": K.cx, "cy": K.cy, "width": 640, "height": 480, "depth_scale": STEP_MM}
    Path("sized.json").write_text(json.dumps(sized))
    pose = make_transform(AWRY[:3, :3], (400.0, 0.0, 900.0))
    Path("mm.txt").write_text(" ".join(map(str, pose.ravel())))
    Path("mm_bin.yaml").write_text(f"inner: [260, 200, 80]\nT_world_bin: {np.eye(4).tolist()}\n")
    pose[:3, 3] = 0.0, 0.0, 850.0
    Path("far_bin.yaml").write_text(f"inner: [0.26, 0.2, 0.08]\nT_world_bin: {pose.tolist()}\n")
    looking = np.diag([1.0, -1.0, -1.0, 1.0])
    looking[2, 3] = 0.85
    Path("hall.yaml").write_text(f"inner: [4, 3, 0.08]\nT_world_bin: {looking.tolist()}\n")
    looking[0, 3] = 2.0
    Path("beside.yaml").write_text(f"inner: [0.26, 0.2, 0.08]\nT_world_bin: {looking.tolist()}\n")
    Path("below.yaml").write_text(f"inner: [0.26, 0.2, 0.08]\nT_world_bin: {make_transform(t=(0, 0, 0.85)).tolist()}\n")
    turned = {"cam_K": [K.fx, 0, 0, 0, K.fy, 0, K.cx, K.cy, 1], "depth_scale": STEP_MM}
    Path("turned.json").write_text(json.dumps(turned))
    content = Path("cloud.ply").read_bytes()
    Path("cut.ply").write_bytes(content[: len(content) * 6 // 10])
    Path("lens.yaml").write_text("K: [900, 0, 320, 0, 900, 240, 0, 0, 1]\nD: [0.1, 0, 0, 0, 0]\n")
    Path("nan.yaml").write_text("{fx: .nan, fy: 900, cx: 320, cy: 240}")
    Path("none.yaml").write_text("focal: 900")
    Path("shear.txt").write_text(" ".join(map(str, (2 * make_transform()).ravel())))
    Path("flat.yaml").write_text("inner: [0.2, 0.2, 0.1]\nT_world_bin: [[1, 0, 0, 0]]\n")


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["nothing.png"], ["nothing.png", "missing"]),
        (["depth.bmp"], ["bmp", ".png", ".ply"]),
        (["depth.png"], ["intrinsics", "--camera", "--fx"]),
        (["depth.png", "--fx", "900"], ["--fy, --cx, --cy"]),
        (["depth.png", "--camera", "camera.json", "--fx", "900"], ["--camera and --fx"]),
        (["depth.png", "--camera", "missing.json"], ["missing.json", "missing"]),
        (["depth.png", "--camera", "none.yaml"], ["none.yaml", "fx, fy, cx, cy"]),
        (["depth.png", "--camera", "nan.yaml"], ["nan.yaml", "finite"]),
        (["depth.png", "--camera", "lens.yaml"], ["lens.yaml", "distortion", "rectif"]),
        (["depth.png", "--camera", "camera.json", "--depth-scale", "1"], ["--depth-scale", "median distance"]),
        (["depth.png", "--camera", "camera.json", "--depth-scale", "0.8"], ["--depth-scale", "bracket", "pixels"]),
        (["depth.png", "--camera", "camera.json", "--depth-scale", "0"], ["--depth-scale", "above 0"]),
        (["depth.png", "--fx", "900", "--fy", "900", "--cx", "320", "--cy", "240"], ["--depth-scale", "missing"]),
        (["depth.png", "--fx", "900", "--fy", "900", "--cx", "240", "--cy", "320"], ["cx, cy", "swapped"]),
        (["depth.png", "--fx", "9", "--fy", "9", "--cx", "1", "--cy", "1"], ["cx, cy", "640 x 480"]),
        (["depth.png", "--camera", "turned.json"], ["turned.json", "column order: transpose it"]),
        (["depth.png", "--camera", "camera.json", "--unit", "mm"], ["--unit", "integers", "--depth-scale"]),
        (["depth.png", "--camera", "camera.json", "--camera-id", "3"], ["--camera-id", "one camera"]),
        (["depth.png", "--camera", "camera.json", "--depth-scale", "0.0001"], ["--depth-scale", "is it in m?"]),
        (["metres.npy", "--camera", "sized.json", "--depth-scale", "1"], ["--depth-scale", "floats", "--unit"]),
        (["awry.npy", "--depth-is", "range"], ["--depth-is", "a cloud"]),
        (["cut.ply", "--unit", "mm"], ["cut.ply", "in the file", "as its header declares", "cut short"]),
        (["awry.npy", "--camera-pose", "mm.txt"], ["mm.txt", "in m, is it in mm?"]),
        (["awry.npy", "--roi", "-200", "-200", "700", "200", "200", "950"], ["--roi", "in m, is it in mm?"]),
        (["awry.npy", "--sigma", "0.12"], ["--sigma", "in m, is it in mm?"]),
        (["awry.npy", "--bin", "mm_bin.yaml"], ["mm_bin.yaml", "inner", "in m, is it in mm?"]),
        (["awry.npy", "--bin", "far_bin.yaml"], ["far_bin.yaml", "T_world_bin", "in m, is it in mm?"]),
        (["awry.npy", "--bin", "hall.yaml"], ["hall.yaml", "inner", "4 x 3 m", "4 times what is seen"]),
        (["awry.npy", "--bin", "beside.yaml"], ["region of interest", "0 measured"]),
        (["awry.npy", "--bin", "below.yaml"], ["below.yaml", "below the floor"]),
        (["small.png", "--camera", "sized.json"], ["small.png", "320 x 240", "640 x 480"]),
        (["eight.png", "--camera", "sized.json"], ["eight.png", "uint8", "16-bit"]),
        (["text.png", "--camera", "sized.json"], ["text.png", "unreadable"]),
        (["black.png", "--camera", "sized.json"], ["black.png", "no pixel"]),
        (["metres.npy", "--camera", "sized.json", "--unit", "mm"], ["metres.npy", "--unit"]),
        (["cloud.ply"], ["cloud.ply", "median distance", "--unit"]),
        (["awry.npy", "--unit", "mm"], ["awry.npy", "median distance", "--unit"]),
        (["text.ply"], ["text.ply", "a point cloud with points"]),
        (["nan.npy"], ["nan.npy", "0 finite points"]),
        (["empty.npy"], ["empty.npy", "0 finite points"]),
        (["words.npy"], ["words.npy", "points (n, 3)"]),
        (["behind.npy"], ["behind.npy", "100 %", "--camera-pose"]),
        (["awry.npy", "--camera-pose", "shear.txt"], ["shear.txt", "rigid"]),
        (["awry.npy", "--roi", "0", "0", "0", "0", "0", "0"], ["--roi", "low corner"]),
        (["awry.npy", "--roi", "9", "9", "9", "10", "10", "10"], ["region of interest", "0 measured"]),
        (["awry.npy", "--bin", "flat.yaml"], ["flat.yaml", "T_world_bin"]),
        (["awry.npy", "--sigma", "-1"], ["--sigma", "above 0"]),
        (["awry.npy", "--weights", "none.safetensors"], ["none.safetensors"]),
    ],
)
def test_bad_input_is_one_line(
    here: Path, words: list[str], names: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    bad_files()
    assert main(["perceive", "bracket", *words]) == 2
    error = capsys.readouterr().err
    assert error.startswith("pickproof: error: ") and error.count("\n") == 1
    assert all(name in error for name in names), error
