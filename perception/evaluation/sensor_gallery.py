"""Pictures of one heap as cameras of each class measure it: `python -m pickproof.perception.evaluation.sensor_gallery
bracket ring_screw`.

Above the measured depth of the whole bin, nearer is brighter and missing pixels are dark red; below a window of it as a
shaded surface, which shows the noise.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pickproof.cell.sensing.sensor_model import SensorConfig, measure
from pickproof.cell.workpiece.optics import Optics
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from pickproof.perception.data.scenes import HELD_OUT_SEED, load_heaps, overhead_view, render_heap

CASES = (
    ("exact", None, "matt_grey"),
    ("structured light, matt", "structured_light", "matt_grey"),
    ("structured light, polished steel", "structured_light", "polished_steel"),
    ("structured light, black plastic", "structured_light", "black_plastic"),
    ("stereo, matt", "stereo", "matt_grey"),
)
MISSING = (0.45, 0.05, 0.1)


def draw_gallery(workpiece: Workpiece, heaps_folder: Path, path: Path) -> None:
    """Write the picture of one heap of the workpiece to `path`."""
    poses = load_heaps(workpiece, HELD_OUT_SEED, 1, heaps_folder, 1)[0]
    figure = Figure(figsize=(20, 6.4), layout="constrained")
    axes = figure.subplots(2, len(CASES))
    for column, (title, preset, material) in enumerate(CASES):
        sensor = SensorConfig.of_preset(preset) if preset else SensorConfig(enabled=False)
        depth, near, far = _measured(replace(workpiece, optics=Optics.of(material)), poses, sensor)
        pixel = depth[depth > 0].mean() / overhead_view(workpiece).intrinsics.fx
        window = np.s_[170:310, 230:416]
        axes[0, column].imshow(_coloured(1 - 0.9 * np.clip((depth - near) / (far - near), 0, 1), depth))
        axes[1, column].imshow(_coloured(_shaded(depth, pixel), depth)[window], interpolation="nearest")
        axes[0, column].set_title(f"{title}: {100 * np.mean(depth == 0):.0f} % missing")
        for axis in axes[:, column]:
            axis.set_axis_off()
    figure.savefig(path, dpi=80)


def _measured(workpiece: Workpiece, poses: np.ndarray, sensor: SensorConfig) -> tuple[np.ndarray, float, float]:
    view = overhead_view(workpiece, sensor)
    exact = render_heap(workpiece, poses, view)
    rng = np.random.default_rng(0)
    frame = measure(exact, view.intrinsics, view.T_world_camera, sensor, rng, workpiece.optics)
    return frame.depth, float(exact.depth[exact.ids >= 0].min()), float(exact.depth.max())


def _shaded(depth: np.ndarray, pixel: float) -> np.ndarray:
    """Lambertian shading of the measured surface under light from the upper left; `pixel` in [m]."""
    z = np.where(depth > 0, depth, np.nan)
    dv, du = (np.gradient(z, axis=axis) / pixel for axis in (0, 1))
    return np.nan_to_num((1 + 0.6 * du + 0.6 * dv) / np.sqrt(1 + du**2 + dv**2) / np.sqrt(1.72), nan=0.7).clip(0, 1)


def _coloured(grey: np.ndarray, depth: np.ndarray) -> np.ndarray:
    return np.where((depth > 0)[..., None], grey[..., None], MISSING)


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("workpieces", nargs="+")
    parser.add_argument("--heaps", type=Path, default=Path("out") / "heaps", help="folder of settled heaps")
    parser.add_argument("--out", type=Path, default=Path("docs") / "images")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    for name in args.workpieces:
        draw_gallery(load_workpiece(name), args.heaps, args.out / f"sensor-{name}.png")


if __name__ == "__main__":
    main()
