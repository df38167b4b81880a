"""Parts that nothing was fitted on, found without training: plates, tees, elbows, valves, near-symmetric and thin ones.

`python -m tests.benchmarks.generated_parts --heaps 4` makes each part by constructive geometry, understands it as
`pickproof onboard` does, settles held-out heaps and prints F1_inst, Recall and precision of the search; FOLDER keeps
workpieces and heaps for another run. Parts whose name begins with fit_ are those that the decisions of the search were
fitted on; the others were never looked at.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh

from pickproof.cell.child_process import FOLDERS, child_environment
from pickproof.cell.mesh.read import read_checked
from pickproof.cell.sensing.sensor_model import SensorConfig
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.perception.data.scenes import HELD_OUT_SEED, load_heaps
from pickproof.perception.evaluation.heap_frames import Setup, perceive_scenes
from pickproof.perception.evaluation.metrics import POINTS, score_frame, summarise, visible_instances
from pickproof.scenarios.onboarding.part import search_symmetry, understand, write_workpiece

Mesh = trimesh.Trimesh


def box(size: tuple[float, float, float], at: tuple[float, float, float] = (0, 0, 0)) -> Mesh:
    """Edge lengths and centre in [mm]."""
    return trimesh.creation.box(size, trimesh.transformations.translation_matrix(at))


def tube(
    radius: float, height: float, axis: str = "z", at: tuple[float, float, float] = (0, 0, 0), sections: int = 32
) -> Mesh:
    """A cylinder in [mm], or a prism of few sections."""
    mesh = trimesh.creation.cylinder(radius, height, sections=sections)
    turn = {"x": (0, np.pi / 2, 0), "y": (np.pi / 2, 0, 0), "z": (0, 0, 0)}[axis]
    mesh.apply_transform(trimesh.transformations.euler_matrix(*turn))
    return mesh.apply_translation(at)


def joined(*meshes: Mesh) -> Mesh:
    """Their union."""
    return trimesh.boolean.union(list(meshes), engine="manifold")


def cut(mesh: Mesh, *tools: Mesh) -> Mesh:
    """What the tools leave."""
    return trimesh.boolean.difference([mesh, *tools], engine="manifold")


def _plate() -> Mesh:
    holes = (tube(4, 20, at=(x, y, 0)) for x, y in ((-30, -12), (30, -12), (22, 14)))
    return cut(box((80, 45, 5)), *holes)


def _tee() -> Mesh:
    outer = joined(tube(12, 70, "x"), tube(12, 32, "y", (0, 16, 0)))
    return cut(outer, tube(9, 80, "x"), tube(9, 40, "y", (0, 20, 0)))


def _elbow() -> Mesh:
    outer = joined(tube(11, 36, "x", (18, 0, 0)), tube(11, 30, "y", (0, 15, 0)), trimesh.creation.icosphere(3, 11))
    return cut(joined(outer, tube(14, 6, "x", (33, 0, 0))), tube(7, 60, "x", (30, 0, 0)), tube(7, 50, "y", (0, 25, 0)))


def _valve() -> Mesh:
    body = joined(tube(11, 64, "x"), trimesh.creation.icosphere(3, 16), tube(8, 26, at=(0, 0, 16)))
    body = joined(body, tube(14, 8, "x", (28, 0, 0), 6), tube(14, 8, "x", (-28, 0, 0), 6))
    return joined(cut(body, tube(7, 80, "x")), box((50, 9, 4), (14, 0, 30)))


def _tee_plate() -> Mesh:
    return joined(box((70, 40, 5)), box((5, 40, 30), (6, 0, 15)))


def _u_profile() -> Mesh:
    return joined(box((60, 30, 3)), box((60, 3, 20), (0, 13.5, 10)), box((60, 3, 20), (0, -13.5, 10)), box((8, 30, 6)))


def _clip() -> Mesh:
    return cut(joined(box((30, 14, 10)), box((12, 14, 22), (9, 0, 6))), tube(4, 30, "y", (9, 0, 10)), box((20, 5, 6)))


def _flange() -> Mesh:
    holes = (tube(4, 20, at=(24 * np.cos(a), 24 * np.sin(a), 0)) for a in (0.0, np.pi / 2, np.pi, 4.4))
    return cut(joined(tube(32, 6), tube(16, 24, at=(0, 0, 12))), tube(10, 80), *holes)


def _wedge() -> Mesh:
    return trimesh.convex.convex_hull([(0, 0, 0), (50, 0, 0), (50, 30, 0), (0, 30, 0), (0, 4, 18), (8, 26, 18)])


def _lever() -> Mesh:
    arm = joined(box((70, 12, 8), (25, 0, 0)), tube(14, 12), tube(9, 18, at=(58, 0, 3)))
    return cut(arm, tube(7, 30), tube(4, 40, at=(58, 0, 0)))


def _comb() -> Mesh:
    return joined(box((60, 10, 6)), *(box((5, 24, 6), (x, 14, 0)) for x in (-26, -12, 4, 24)))


def _washer() -> Mesh:
    return cut(tube(22, 4), tube(10, 10), box((30, 6, 10), (18, 0, 0)))


def _knob() -> Mesh:
    return joined(tube(15, 18), tube(11, 10, at=(0, 0, 12)), box((4, 16, 6), (0, 12, 18)))


def _rail() -> Mesh:
    return joined(box((120, 18, 4)), box((120, 5, 14), (0, 0, 7)), box((10, 18, 12), (48, 0, 5)))


def _cross() -> Mesh:
    return joined(box((60, 12, 12)), box((12, 44, 12)), box((12, 12, 30), (0, 0, 10)))


def _housing() -> Mesh:
    return cut(joined(box((50, 36, 26)), tube(8, 20, at=(14, 8, 18))), box((42, 28, 26), (0, 0, -4)), tube(5, 60))


def _fit_angle() -> Mesh:
    return cut(joined(box((50, 30, 4)), box((4, 30, 34), (-23, 0, 15))), tube(4, 20, at=(10, 6, 0)))


def _fit_cap() -> Mesh:
    return cut(joined(tube(20, 22), box((10, 12, 8), (20, 0, 4))), tube(16, 22, at=(0, 0, -5)))


def _fit_handle() -> Mesh:
    return joined(tube(6, 60, "x"), tube(5, 24, at=(-24, 0, -12)), tube(5, 24, at=(24, 0, -12)), tube(9, 6, "x"))


def _fit_nut() -> Mesh:
    return cut(joined(tube(17, 12, sections=6), tube(20, 4, at=(0, 0, -6))), tube(8, 40))


def _fit_plate() -> Mesh:
    return cut(box((70, 50, 6)), tube(8, 20, at=(-18, 8, 0)), box((20, 10, 20), (16, -12, 0)))


def _fit_tee() -> Mesh:
    return joined(tube(10, 60, "x"), tube(10, 26, "y", (5, 13, 0)), tube(13, 8, "x", (26, 0, 0)))


def _fit_clevis() -> Mesh:
    ears = box((24, 6, 30), (10, 11, 0)), box((24, 6, 30), (10, -11, 0))
    return cut(joined(box((16, 28, 30), (-8, 0, 0)), *ears), tube(5, 60, "y", (14, 0, 4)))


def _fit_bent() -> Mesh:
    return joined(box((40, 30, 6)), box((6, 30, 26), (17, 0, 12)), box((24, 30, 6), (28, 0, 24)))


PARTS: dict[str, Callable[[], Mesh]] = {
    name.removeprefix("_"): make
    for name, make in sorted(globals().items())
    if name.startswith("_") and callable(make) and getattr(make, "__annotations__", {}).get("return") == "Mesh"
}


def make_workpiece(name: str, folder: Path) -> None:
    """The part as a workpiece in a folder of workpieces, as `pickproof onboard` understands it."""
    if (folder / name).is_dir():
        return
    folder.mkdir(parents=True, exist_ok=True)
    mesh_file = folder / f"{name}.stl"
    PARTS[name]().export(mesh_file)
    checked = read_checked(mesh_file, "mm")
    mesh, found = search_symmetry(checked)
    write_workpiece(understand(name, "steel", checked, mesh, found, found.degrees), folder / name)


def measure(name: str, folder: Path, heaps: int, sensor: SensorConfig) -> dict[str, float]:
    """Figures of the search on held-out heaps; shares in per cent, processor time of a frame, reading included."""
    workpiece = load_workpiece(name)
    poses = load_heaps(workpiece, HELD_OUT_SEED, heaps, folder / "heaps", 1)
    setup = Setup(name, None, sensor, HELD_OUT_SEED, method="search")
    setup.load()  # compiled and precomputed before the clock runs
    points, scores, begun, wall = workpiece.sample_surface(POINTS)[0], [], time.process_time(), 0.0
    for seen in perceive_scenes(setup, poses):
        counted = visible_instances(seen.pixels)
        scores.append(score_frame(seen.Ts_estimated, seen.Ts_camera_part, counted, workpiece, points=points))
        wall += sum(seen.result.seconds.values())
    s = summarise(scores)
    seconds = (time.process_time() - begun) / len(poses)
    shares = {"f1_inst": 100 * s.f1_inst, "recall": 100 * s.recall, "precision": 100 * s.precision}
    return shares | {"instances": sum(f.n_gt for f in scores), "seconds": seconds, "wall_seconds": wall / len(poses)}


def main() -> None:
    """Print a line for each part and the median."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", help="default: all but those of the fit")
    parser.add_argument("--heaps", type=int, default=4)
    parser.add_argument("--sensor", default="structured_light")
    parser.add_argument("--folder", type=Path, default=Path("out") / "generated_parts")
    args = parser.parse_args()
    names = args.parts or [name for name in PARTS if not name.startswith("fit_")]
    found: dict[str, dict[str, float]] = {}
    with child_environment({FOLDERS: str(args.folder.resolve())}):
        for name in names:
            make_workpiece(name, args.folder)
            found[name] = measure(name, args.folder, args.heaps, SensorConfig.of_preset(args.sensor))
            print(name, json.dumps({k: round(v, 2) for k, v in found[name].items()}), flush=True)
    f1 = [figures["f1_inst"] for figures in found.values()]
    print(f"median F1 {np.median(f1):.1f}, mean {np.mean(f1):.1f}, least {min(f1):.1f} of {len(f1)} parts")


if __name__ == "__main__":
    main()
