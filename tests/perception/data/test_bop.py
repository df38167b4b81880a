"""Export as a BOP dataset against the published format and against ray casting, and the way back."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from pickproof.cell.errors import InputError
from pickproof.cell.frames import apply
from pickproof.cell.sensing.camera import render
from pickproof.cell.sensing.sensor_model import SensorConfig
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.perception.data.bop_models import model_info, symmetry_fields
from pickproof.perception.data.bop_read import read_bop
from pickproof.perception.data.bop_write import Export, export_bop
from pickproof.perception.data.scenes import heap_boxes, overhead_view, render_heap
from pickproof.perception.evaluation.bop_results import write_results
from pickproof.perception.evaluation.metrics import score_frame, visible_instances
from pickproof.perception.pose_estimate import PoseEstimate
from pickproof.perception.refinement.refine import RefineResult
from pickproof.scenarios.commands.cli import main
from tests.perception.data.bop_checker import problems_of, read_results
from tests.perception.small_heaps import bracket, small_heaps

pytestmark = pytest.mark.slow

HEAPS = slice(0, 2)


def export(folder: Path, split: str = "train", first_seed: int = 4_000_000) -> Export:
    return Export("bracket", folder, split, 2, SensorConfig(), first_seed, "a test")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenes of two images each, exported twice: in one process as train, in two as test."""
    folder = tmp_path_factory.mktemp("bop") / "set"
    for split, workers in (("train", 1), ("test", 2)):
        export_bop(export(folder, split), small_heaps()[HEAPS], workers)
    return folder


@pytest.fixture
def copy(dataset: Path, tmp_path: Path) -> Path:
    """One scene with one image."""
    folder = tmp_path / "set"
    shutil.copytree(dataset, folder, ignore=shutil.ignore_patterns("test*", "000001*"))
    for name in ("camera", "gt", "gt_info"):
        edit(folder / f"train/000000/scene_{name}.json", lambda document: document.pop("1"))
    return folder


def edit(path: Path, change: Callable) -> None:
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


def test_the_published_format(dataset: Path) -> None:
    assert problems_of(dataset, "train") == []
    targets = json.loads((dataset / "test_targets_bop19.json").read_text())
    assert {(t["scene_id"], t["im_id"], t["obj_id"]) for t in targets} == {(s, i, 1) for s in (0, 1) for i in (0, 1)}


def test_a_dataset_does_not_depend_on_the_number_of_workers(dataset: Path) -> None:
    files = [p.relative_to(dataset / "train") for p in (dataset / "train").rglob("*") if p.is_file()]
    assert len(files) > 50
    for file in files:
        assert (dataset / "train" / file).read_bytes() == (dataset / "test" / file).read_bytes()


@pytest.mark.parametrize("fault", ["transposed", "metres", "mask", "count"])
def test_the_checker_sees_faults(copy: Path, fault: str) -> None:
    assert problems_of(copy, "train") == []
    scene = copy / "train" / "000000"

    def wrong(entries: dict) -> None:
        for entry in entries["0"]:
            if fault == "transposed":
                entry["cam_R_m2c"] = np.reshape(entry["cam_R_m2c"], (3, 3)).T.ravel().tolist()
            elif fault == "metres":
                entry["cam_t_m2c"] = [x / 1000 for x in entry["cam_t_m2c"]]
            elif fault == "count":
                entry["px_count_visib"] += 1

    if fault == "mask":
        shutil.copy(scene / "mask/000000_000001.png", scene / "mask_visib/000000_000000.png")
    edit(scene / ("scene_gt_info.json" if fault == "count" else "scene_gt.json"), wrong)
    assert any(problem.startswith("000000/0/") for problem in problems_of(copy, "train"))


def test_visibility_is_that_of_ray_casting(dataset: Path) -> None:
    """Each instance is cast alone; it is visible where the whole scene has its depth."""
    view, poses = overhead_view(bracket()), small_heaps()[0]
    infos = json.loads((dataset / "train/000000/scene_gt_info.json").read_text())["0"]
    everything = render_heap(bracket(), poses, view).depth
    part = bracket().vertices, bracket().faces
    assert len(infos) == len(poses) and len(heap_boxes(bracket())) == 6
    for T, info in zip(poses, infos, strict=True):
        alone = render(*part, T[None], (), view.intrinsics, view.T_world_camera).depth
        seen = (alone > 0) & (np.abs(alone - everything) < 2e-5)
        assert info["px_count_all"] == pytest.approx((alone > 0).sum(), rel=0.01)
        assert info["visib_fract"] == pytest.approx(seen.sum() / (alone > 0).sum(), abs=0.01)


def test_the_poses_come_back(dataset: Path) -> None:
    images = read_bop(dataset, "train", None, bracket())
    assert [(i.scene, i.image) for i in images] == [(0, 0), (0, 1), (1, 0), (1, 1)]
    for image in images:
        world = image.T_world_camera @ image.Ts_camera_part
        np.testing.assert_allclose(world, small_heaps()[image.scene], atol=1e-6)
        frame = image.frame()
        assert frame.intrinsics == overhead_view(bracket()).intrinsics
        assert image.bin is not None and image.bin.inner == pytest.approx(bracket().heap.bin_inner)
    exact = render_heap(bracket(), small_heaps()[0], overhead_view(bracket()))
    np.testing.assert_array_equal(images[0].ids(images[0].frame(), bracket()), exact.ids)


def test_what_is_visible_without_masks(copy: Path) -> None:
    """Where there are no masks, the CAD at the true poses explains the depth; on measured pixels both agree."""
    (image,) = read_bop(copy, None, None, bracket())
    frame = image.frame()
    by_mask = image.ids(frame, bracket())
    shutil.rmtree(copy / "train/000000/mask_visib")
    by_depth = image.ids(frame, bracket())
    measured = (frame.depth > 0) & (by_mask >= 0)
    assert (by_depth == by_mask)[measured].mean() > 0.99
    assert (by_depth[(frame.depth > 0) & (by_mask < 0)] >= 0).mean() < 0.01


def test_a_model_whose_origin_lies_elsewhere(copy: Path, tmp_path: Path) -> None:
    """The same scene told in a model frame 10, 0, -4 mm off: the workpiece's poses stay, results go back to it."""
    (before,) = read_bop(copy, None, None, bracket())
    shift = np.array([10.0, 0.0, -4.0])
    path = copy / "models/obj_000001.ply"
    mesh = trimesh.load(path, force="mesh")
    mesh.apply_translation(shift)
    mesh.export(path)

    def moved(truth: dict) -> None:
        for entry in truth["0"]:
            entry["cam_t_m2c"] = (entry["cam_t_m2c"] - np.reshape(entry["cam_R_m2c"], (3, 3)) @ shift).tolist()

    edit(copy / "train/000000/scene_gt.json", moved)
    (after,) = read_bop(copy, None, None, bracket())
    np.testing.assert_allclose(after.Ts_camera_part, before.Ts_camera_part, atol=1e-6)
    found = [PoseEstimate(T, 0.5, 1.0, 0.0, 1) for T in after.Ts_camera_part]
    write_results(tmp_path / "r.csv", [(after, RefineResult(found, [], {"network": 0.5, "icp": 0.25}))])
    truth = json.loads((copy / "train/000000/scene_gt.json").read_text())["0"]
    for result, entry in zip(read_results(tmp_path / "r.csv"), truth, strict=True):
        assert (result["image"], result["obj"], result["score"], result["time"]) == ((0, 0), 1, 0.5, 0.75)
        np.testing.assert_allclose(result["R"].ravel(), entry["cam_R_m2c"], atol=1e-8)
        np.testing.assert_allclose(result["t"], entry["cam_t_m2c"], atol=1e-5)


def test_several_objects(copy: Path) -> None:
    """Two objects that are both brackets: one is asked for, and its instances alone come back."""
    shutil.copy(copy / "models/obj_000001.ply", copy / "models/obj_000007.ply")
    edit(copy / "models/models_info.json", lambda infos: infos.update({"7": infos["1"]}))
    edit(copy / "train/000000/scene_gt.json", lambda truth: [e.update(obj_id=7) for e in truth["0"][:3]])
    with pytest.raises(InputError, match=r"--obj.*1, 7"):
        read_bop(copy, None, None, bracket())
    (image,) = read_bop(copy, None, 7, bracket())
    assert (image.obj, image.indices) == (7, (0, 1, 2))
    ids = image.ids(image.frame(), bracket())
    assert set(np.unique(ids)) <= {-1, 0, 1, 2}
    (rest,) = read_bop(copy, None, 1, bracket())
    assert len(rest.Ts_camera_part) == len(small_heaps()[0]) - 3


@pytest.mark.parametrize("name", ["bracket", "candlestick", "tless_20", "ps6d_24", "ring_screw"])
def test_symmetries_map_the_model_to_itself(name: str) -> None:
    workpiece = load_workpiece(name)
    info = model_info(workpiece)
    discrete = [np.reshape(T, (4, 4)) for T in info.get("symmetries_discrete", [])]
    assert len(discrete) == len(workpiece.symmetry.S) - 1
    assert ("symmetries_continuous" in info) == (workpiece.symmetry.infinite_axis is not None)
    points = workpiece.sample_surface(60)[0]
    for T in discrete:
        off = np.abs(trimesh.proximity.signed_distance(workpiece.mesh, apply(T, points))).max()
        assert off < 0.01 * workpiece.extents.max()
    assert symmetry_fields(load_workpiece("bracket").symmetry) == {}


def test_an_export_goes_on_and_keeps_to_its_folder(dataset: Path, copy: Path, tmp_path: Path) -> None:
    before = {p: p.stat().st_mtime_ns for p in dataset.rglob("*.png")}
    export_bop(export(dataset), small_heaps()[HEAPS])
    assert before == {p: p.stat().st_mtime_ns for p in dataset.rglob("*.png")}
    with pytest.raises(InputError, match=r"dataset_info\.json.*same options"):
        export_bop(export(dataset, first_seed=5), small_heaps()[HEAPS])
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.tex").touch()
    with pytest.raises(InputError, match="not empty"):
        export_bop(export(tmp_path / "full"), small_heaps()[HEAPS])


def test_evaluate_finds_what_is_there(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["--bop", str(dataset), "--split", "test", "--frames", "1", "--bop-results", "r.csv", "--json"]
    assert main(["evaluate", "bracket", *words]) == 0
    refined = json.loads(capsys.readouterr().out)["methods"]["ps6d_refined"]
    results = read_results(tmp_path / "r.csv")
    tp, n_gt, n_pred = 0, 0, 0
    for image in read_bop(dataset, "test", None, bracket())[:1]:  # the score anew, from the file
        T = np.tile(np.eye(4), (sum(r["image"] == (image.scene, image.image) for r in results), 1, 1))
        T[:, :3, :3] = [r["R"] for r in results if r["image"] == (image.scene, image.image)]
        T[:, :3, 3] = [r["t"] / 1000 for r in results if r["image"] == (image.scene, image.image)]
        ids = image.ids(image.frame(), bracket())
        counted = visible_instances(np.bincount(ids[ids >= 0], minlength=len(image.Ts_camera_part)))
        score = score_frame(T, image.Ts_camera_part, counted, bracket())
        tp, n_gt, n_pred = tp + score.true_positives, n_gt + score.n_gt, n_pred + score.n_pred
    assert refined["f1_inst"] == pytest.approx(100 * 2 * tp / (n_gt + n_pred))
    assert refined["f1_inst"] > 80


def test_train_takes_a_dataset(dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From the shipped weights: what they know of settled heaps holds for the images of a dataset."""
    monkeypatch.chdir(tmp_path)
    words = ["--bop", str(dataset), "--split", "train", "--clouds", "2", "--batch", "1", "--lr", "1e-9"]
    assert main(["train", "bracket", *words, "--loaders", "0", "--init", "bracket"]) == 0
    record = json.loads((tmp_path / "out/train/bracket/record.json").read_text())
    assert record["validation"]["right"] > 0.5
    assert "--bop" in record["command"]


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["evaluate", "bracket", "--bop", "nowhere"], ["--bop", "nowhere"]),
        (["evaluate", "bracket", "--bop", "{set}"], ["--split", "test", "train"]),
        (["evaluate", "bracket", "--bop", "{set}", "--split", "val"], ["--split", "val", "test", "train"]),
        (["evaluate", "bracket", "--bop", "{set}", "--split", "test", "--obj", "3"], ["--obj", "3", "one of: 1"]),
        (["evaluate", "tless_20", "--bop", "{set}", "--split", "test"], ["obj_000001.ply", "56 x 18 x 14"]),
        (["evaluate", "bracket", "--bop", "{set}", "--no-noise"], ["--no-noise", "--bop"]),
        (["evaluate", "bracket", "--split", "test"], ["--split", "--bop"]),
        (["evaluate", "bracket", "--bop-results", "r.csv"], ["--bop-results", "--bop"]),
        (["evaluate", "bracket", "--data", "{set}"], ["set.json", "pickproof generate bracket"]),
        (
            ["evaluate", "bracket", "--bop", "{set}", "--split", "test", "--bop-sensor", "x"],
            ["--bop-sensor", "has but one"],
        ),
        (["evaluate", "bracket", "--bop-sensor", "photoneo"], ["--bop-sensor", "--bop"]),
        (["train", "bracket", "--bop", "nowhere"], ["--bop", "nowhere"]),
        (["generate", "bracket", "--export", "coco", "x"], ["--export", "coco", "bop"]),
        (["generate", "bracket", "--export", "bop", "x", "--split", "all"], ["--split", "all", "train"]),
    ],
)
def test_bad_input_is_named(
    dataset: Path, words: list[str], names: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main([word.format(set=dataset) for word in words]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert all(name in error for name in names), error


@pytest.mark.parametrize(
    ("file", "content", "name"),
    [
        ("scene_gt.json", None, "scene_gt"),
        ("scene_camera.json", "{", "scene_camera"),
        ("scene_camera.json", '{"0": {"cam_K": [1, 2], "depth_scale": 1}}', "scene_camera"),
        ("scene_gt.json", '{"0": [{"obj_id": 1, "cam_R_m2c": [1], "cam_t_m2c": [0, 0, 1]}]}', "scene_gt"),
        ("scene_gt.json", '{"0": 1}', "scene_gt"),
        ("scene_gt.json", '[["a"]]', "scene_gt"),
        ("scene_camera.json", '{"0": 1}', "scene_camera"),
        ("depth/000000.png", "no picture", "000000.png"),
        ("mask_visib/000000_000000.png", "no picture", "000000_000000.png"),
    ],
)
def test_damaged_files_are_named(copy: Path, file: str, content: str | None, name: str) -> None:
    path = copy / "train/000000" / file
    path.unlink() if content is None else path.write_text(content)
    with pytest.raises(InputError, match=name if content is not None else "split"):
        for image in read_bop(copy, None, None, bracket()):
            image.ids(image.frame(), bracket())


def test_a_model_cut_short_is_refused_with_its_counts(copy: Path) -> None:
    path = copy / "models/obj_000001.ply"
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(InputError, match=r"obj_000001\.ply: '\d+ of \d+ declared faces: the file was cut short'"):
        read_bop(copy, None, None, bracket())


def test_inverse_of_a_pose_is_the_way_back(dataset: Path) -> None:
    """cam_R_w2c, cam_t_w2c takes the world to the camera, in mm."""
    entry = json.loads((dataset / "train/000000/scene_camera.json").read_text())["0"]
    eye = -np.reshape(entry["cam_R_w2c"], (3, 3)).T @ entry["cam_t_w2c"]
    np.testing.assert_allclose(eye, 1000 * overhead_view(bracket()).T_world_camera[:3, 3], atol=1e-6)


def of_industry(scene: Path, sensor: str) -> None:
    """Names of a scene's files and folders as BOP-Industrial has them."""
    for path in list(scene.iterdir()):
        if path.stem in ("scene_gt", "scene_gt_info", "scene_camera", "depth", "mask", "mask_visib"):
            path.rename(path.with_name(f"{path.stem}_{sensor}{path.suffix}"))


def test_several_sensors(copy: Path, dataset: Path) -> None:
    (before,) = read_bop(copy, None, None, bracket())
    scene = copy / "train" / "000000"
    of_industry(scene, "photoneo")
    (alone,) = read_bop(copy, None, None, bracket())  # the only one
    assert alone.sensor == "photoneo"
    for name in ("scene_gt", "scene_camera"):
        shutil.copy(scene / f"{name}_photoneo.json", scene / f"{name}_cam1.json")
    assert read_bop(copy, None, None, bracket())[0].sensor == "photoneo"  # the other one has no depth
    shutil.copytree(scene / "depth_photoneo", scene / "depth_cam1")
    with pytest.raises(InputError, match=r"--bop-sensor.*one of: cam1, photoneo"):
        read_bop(copy, None, None, bracket())
    with pytest.raises(InputError, match=r"--bop-sensor.*stereo.*one of: cam1, photoneo"):
        read_bop(copy, None, None, bracket(), "stereo")
    for sensor in ("photoneo", "cam1"):
        (image,) = read_bop(copy, None, None, bracket(), sensor)
        np.testing.assert_array_equal(image.Ts_camera_part, before.Ts_camera_part)
        assert image.frame().depth.any()
    (image,) = read_bop(copy, None, None, bracket(), "photoneo")
    exact = render_heap(bracket(), small_heaps()[0], overhead_view(bracket()))
    np.testing.assert_array_equal(image.ids(image.frame(), bracket()), exact.ids)


@pytest.mark.parametrize(
    ("file", "entry", "field", "by", "message"),
    [
        ("scene_gt", "list", "cam_t_m2c", 0.001, r"cam_t_m2c.*in mm, is it in m\?"),
        ("scene_gt", "list", "cam_t_m2c", 1000, r"cam_t_m2c.*below 20000 mm"),
        ("scene_gt", "list", "cam_R_m2c", 2, "cam_R_m2c.*rotation"),
        ("scene_camera", "", "cam_t_w2c", 0.001, r"cam_t_w2c.*in mm, is it in m\?"),
        ("scene_camera", "", "depth_scale", 0.001, r"depth_scale.*in mm, is it in m\?"),
        ("scene_camera", "", "cam_K", 2, "row by row"),
    ],
)
def test_units_of_a_dataset(copy: Path, file: str, entry: str, field: str, by: float, message: str) -> None:
    def change(document: dict) -> None:
        holder = document["0"][0] if entry else document["0"]
        holder[field] = (by * np.asarray(holder[field])).tolist()

    edit(copy / f"train/000000/{file}.json", change)
    with pytest.raises(InputError, match=message):
        read_bop(copy, None, None, bracket())


def test_a_bin_in_metres_is_named(copy: Path) -> None:
    def change(document: dict) -> None:
        document["bin"]["inner"] = [x / 1000 for x in document["bin"]["inner"]]

    edit(copy / "dataset_info.json", change)
    with pytest.raises(InputError, match=r"bin.inner.*in mm, is it in m\?"):
        read_bop(copy, None, None, bracket())
