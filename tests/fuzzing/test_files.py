"""Files of users: the right values, or one reason; never another exception, never other values."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pickproof.cell.sensing.camera import Intrinsics
from pickproof.perception.camera_files.camera_file import read_camera
from tests.fuzzing import cameras, clouds, yaml_files

pytestmark = pytest.mark.slow

EXAMPLES = {cameras: 500, clouds: 60, yaml_files: 150}


@pytest.mark.parametrize("kind", list(EXAMPLES), ids=lambda kind: kind.__name__.rpartition(".")[2])
def test_a_hostile_file_is_read_right_or_refused(kind: ModuleType, tmp_path: Path) -> None:
    counts: Counter[str] = Counter()
    for seed in range(EXAMPLES[kind]):
        suffix, content = kind.hostile(np.random.default_rng(seed))
        path = tmp_path / f"{seed}{suffix}"
        path.write_bytes(content)
        try:
            counts[kind.check(path)] += 1
        except Exception as error:
            raise AssertionError(f"seed {seed}: {content[:2000]!r}") from error
    assert min(counts["read"], counts["refused"]) > EXAMPLES[kind] / 20, counts


@st.composite
def intrinsics(draw: st.DrawFn) -> Intrinsics:
    width, height = draw(st.integers(64, 4000)), draw(st.integers(64, 4000))
    fx = width * draw(st.floats(0.4, 8))
    fy = fx * draw(st.floats(0.8, 1.25))
    cx, cy = (n * draw(st.floats(0.45, 0.55)) for n in (width, height))
    return Intrinsics(width, height, fx, fy, cx, cy)


@pytest.mark.parametrize("layout", list(cameras.LAYOUTS))
@settings(derandomize=True, max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(K=intrinsics().filter(lambda K: K.height * 0.3 < K.fy < K.height * 20))
def test_every_layout_is_read(layout: str, K: Intrinsics, tmp_path: Path) -> None:
    document = cameras.LAYOUTS[layout](K)
    writers = {**cameras.WRITERS, **({".yml": cameras.file_storage} if layout == "opencv" else {})}
    for suffix, write in writers.items():
        path = tmp_path / f"camera{suffix}"
        path.write_bytes(write(document))
        camera = read_camera(path, Path("000003.png"))
        found = camera.intrinsics(K.width, K.height, path)
        np.testing.assert_allclose(list(vars(found).values()), list(vars(K).values()), rtol=1e-12)
        assert camera.size in (None, (K.width, K.height))
        assert (camera.size is None) == (layout == "bop_scene")
        cameras.same_pose(camera.T_world_camera)
        assert (camera.T_world_camera is not None) == (layout in ("bop_scene", "open3d_parameters", "own"))
        assert camera.depth_step in (None, pytest.approx(cameras.STEP))
