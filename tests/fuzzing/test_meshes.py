"""Whole files of every format give the volume that they were made with; damaged ones give it too, or one line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pickproof.cell.errors import InputError
from pickproof.cell.mesh.check import check_mesh
from pickproof.cell.mesh.checked import as_trimesh
from pickproof.cell.mesh.read import read_checked_here
from tests.fuzzing.mesh_writers import VOLUME, WRITERS, Solid, random_solid
from tests.fuzzing.meshes import check_mesh_file, cut, hostile_mesh

pytestmark = pytest.mark.slow

SEEDS = st.integers(0, 2**32 - 1)
EVERY = [pytest.param(f".{kind}", write, id=write.__name__) for kind, writers in WRITERS.items() for write in writers]


def often(examples: int) -> settings:
    """The same examples in every run; the folder may be used again, as each writes its own file."""
    quiet = [HealthCheck.function_scoped_fixture]
    return settings(max_examples=examples, derandomize=True, deadline=None, database=None, suppress_health_check=quiet)


def volume(path: Path, data: bytes) -> float:
    """[mm3] of what is read."""
    path.write_bytes(data)
    return float(as_trimesh(read_checked_here(path, "mm")).volume) * 1e9


@pytest.mark.parametrize(("suffix", "write"), EVERY)
def test_whole_files_have_their_volume(suffix: str, write: Callable[..., bytes], tmp_path: Path) -> None:
    @often(60)
    @given(SEEDS)
    def check(seed: int) -> None:
        rng = np.random.default_rng(seed)
        data = write(random_solid(rng), rng)
        assert volume(tmp_path / f"part{suffix}", data) == pytest.approx(VOLUME, rel=1e-4)

    check()


@pytest.mark.parametrize(("suffix", "write"), EVERY)
def test_files_cut_short_have_it_or_are_refused(suffix: str, write: Callable[..., bytes], tmp_path: Path) -> None:
    """OBJ declares no counts: that a body is missing cannot be told where the file ends between two."""

    @often(60)
    @given(SEEDS)
    def check(seed: int) -> None:
        rng = np.random.default_rng(seed)
        solid = random_solid(rng)
        data = write(solid, rng)
        short = data[: -int(rng.integers(1, 300))] if rng.random() < 0.5 else cut(data, rng)
        try:
            found = volume(tmp_path / f"part{suffix}", short)
        except InputError as error:
            assert "\n" not in str(error)
            return
        allowed = [VOLUME, first_body(solid)] if suffix == ".obj" else [VOLUME]
        assert any(found == pytest.approx(v, rel=1e-4) for v in allowed)

    check()


def first_body(solid: Solid) -> float:
    corners = Solid(solid.bodies[:1]).triangles.reshape(-1, 3)
    return float(as_trimesh(check_mesh(corners, np.arange(len(corners)).reshape(-1, 3), "mm")).volume) * 1e9


@often(400)
@given(SEEDS)
def test_hostile_files_are_read_or_refused(tmp_path: Path, seed: int) -> None:
    suffix, data = hostile_mesh(np.random.default_rng(seed))
    path = tmp_path / f"part{suffix}"
    path.write_bytes(data)
    assert check_mesh_file(path) in ("read", "refused")
