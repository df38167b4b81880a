"""Both ray casters see the same, and training runs where Open3D and PyBullet are missing."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import pickproof.cell.sensing.camera
from pickproof.cell.frames import Array, from_rpy, make_transform
from pickproof.cell.geometry.bin import Box, table
from pickproof.cell.geometry.raycast import EmbreexCaster, Open3dCaster, RayCaster, make_caster
from pickproof.cell.sensing.camera import Intrinsics, Render, RenderOptions, look_at, render
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from pickproof.perception.data.scenes import heap_fingerprint

TRIANGLE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.array([[0, 1, 2]])
CASTERS = [Open3dCaster, EmbreexCaster]
BLOCKED = "import sys; sys.modules.update(dict.fromkeys(['open3d', 'pybullet', 'libusb_package']))\n"
TRAIN = """
from pathlib import Path
import numpy as np
import pickproof.perception.training.train, pickproof.perception.training.trainer
from pickproof.cell.geometry.raycast import EmbreexCaster, make_caster
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.perception.training.dataset import train_sample
from pickproof.perception.data.scenes import load_heaps
assert isinstance(make_caster(np.eye(3), np.array([[0, 1, 2]])), EmbreexCaster)
workpiece = load_workpiece("bracket")
heaps = load_heaps(workpiece, 5, 1, Path(sys.argv[1]), 1)
print(int(train_sample(workpiece, heaps, 0, 0).keep.sum()))
"""


@pytest.mark.parametrize("caster", CASTERS)
def test_hits_are_in_lengths_of_the_direction(caster: type[RayCaster]) -> None:
    hits = caster(*TRIANGLE).cast(
        np.array([0.2, 0.3, 3.0]), np.array([[0.0, 0.0, -1.0], [0.0, 0.0, -2.0], [0, 0, 1], [1, 0, -1]])
    )
    np.testing.assert_allclose(hits.t, [3.0, 1.5, np.inf, np.inf], rtol=1e-6)
    np.testing.assert_array_equal(hits.face, [0, 0, -1, -1])


def test_open3d_is_taken_where_it_is_there() -> None:
    assert isinstance(make_caster(*TRIANGLE), Open3dCaster)


def rendered(caster: type[RayCaster], workpiece: Workpiece, monkeypatch: pytest.MonkeyPatch) -> Render:
    rng = np.random.default_rng(0)
    Ts = make_transform(np.eye(3), rng.uniform([-0.08, -0.06, 0.0], [0.08, 0.06, 0.05], (12, 3)))
    for T in Ts:
        T[:3, :3] = from_rpy(rpy=tuple(rng.uniform(-3, 3, 3)))[:3, :3]
    boxes = [table((1.0, 1.0, 0.1), (0.0, 0.0, 0.0)), Box("wall", (0.01, 0.3, 0.08), make_transform(t=(0.1, 0, 0.04)))]

    def chosen(vertices: Array, faces: np.ndarray, threads: int) -> RayCaster:
        return caster(vertices, faces)

    monkeypatch.setattr(pickproof.cell.sensing.camera, "make_caster", chosen)
    K, T = Intrinsics.from_fov(320, 240, np.deg2rad(25)), look_at((0.05, 0.02, 0.8), (0.0, 0.0, 0.0))
    return render(workpiece.vertices, workpiece.faces, Ts, boxes, K, T, RenderOptions((0.12, 0.0, 0.0), True))


def test_both_casters_render_the_same(bracket: Workpiece, monkeypatch: pytest.MonkeyPatch) -> None:
    a, b = (rendered(caster, bracket, monkeypatch) for caster in CASTERS)
    assert len(np.unique(a.ids)) > 8
    assert 0.01 < np.mean(~a.lit) < 0.5
    same = np.abs(a.depth - b.depth) < 1e-5
    assert same.mean() > 0.9995  # a ray along an edge may hit either side
    assert (a.ids == b.ids).mean() > 0.9995
    assert (a.lit == b.lit).mean() > 0.999
    assert a.reflected is not None and b.reflected is not None
    both = same & np.isfinite(a.reflected) & np.isfinite(b.reflected)
    assert np.mean(np.isfinite(a.reflected) == np.isfinite(b.reflected)) > 0.999
    assert np.quantile(np.abs(a.reflected[both] - b.reflected[both]), 0.999) < 1e-4


@pytest.mark.slow
def test_training_runs_without_open3d_and_pybullet(tmp_path: Path) -> None:
    """With a stored heap; the two are blocked in a process of their own."""
    rng = np.random.default_rng(0)
    Ts = make_transform(np.eye(3), rng.uniform([-0.1, -0.08, 0.02], [0.1, 0.08, 0.06], (20, 3)))
    made_of = np.array(heap_fingerprint(load_workpiece("bracket")))
    np.savez_compressed(tmp_path / "heaps-bracket-5.npz", **{"5": Ts, "fingerprint": made_of})
    run = subprocess.run(
        [sys.executable, "-c", BLOCKED + TRAIN, str(tmp_path)], capture_output=True, text=True, check=False, timeout=300
    )
    assert run.returncode == 0, run.stderr
    assert int(run.stdout) > 100
