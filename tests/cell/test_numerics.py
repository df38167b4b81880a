"""The numeric profile stands before libraries are loaded, and a process that missed it says so."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from pickproof.cell import numerics
from pickproof.cell.errors import InputError

ROOT = Path(__file__).resolve().parents[2]
ROOMS = (
    "pickproof",
    "pickproof.cell",
    "pickproof.perception.ps6d.point_hierarchy",
    "pickproof.grasping.ranking",
    "pickproof.robots.kinematics.chain",
    "pickproof.scenarios.comparison.pytest_plugin",
)


def run(code: str, **environment: str) -> str:
    clean = {n: v for n, v in os.environ.items() if n != numerics.SWITCH and n not in numerics._KERNELS}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=clean | environment, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.slow
@pytest.mark.parametrize("room", ROOMS)
def test_every_room_fixes_the_kernels_before_numpy(room: str) -> None:
    code = (
        f"import {room}, numpy; from pickproof.cell.numerics import has_profile, PORTABLE; print(has_profile(PORTABLE))"
    )
    assert run(code) == "True"


def test_numpy_takes_the_kernel_of_the_profile() -> None:
    code = (
        "import pickproof, numpy, threadpoolctl; numpy.ones((9, 9)) @ numpy.ones((9, 9)); "
        "print({i['architecture'] for i in threadpoolctl.threadpool_info() if i['internal_api'] == 'openblas'})"
    )
    assert run(code) == "{'Haswell'}"
    assert run(code, OPENBLAS_CORETYPE="Nehalem") == "{'Haswell'}"
    native = {numerics.SWITCH: "native", "OPENBLAS_CORETYPE": "Nehalem"}
    assert run(code, **native) == "{'Nehalem'}"


def test_a_process_that_loaded_numpy_first_does_not_claim_the_profile() -> None:
    code = (
        "import numpy, pickproof; from pickproof.cell.numerics import has_profile, profile as p; "
        "print(p(), has_profile(p()))"
    )
    assert run(code) == f"{numerics.PORTABLE} False"
    child = (
        "import numpy, pickproof, subprocess, sys; print(subprocess.run([sys.executable, '-c', "
        "'from pickproof.cell.numerics import has_profile, profile; print(has_profile(profile()))'],"
        " capture_output=True, text=True).stdout)"
    )
    assert run(child) == "True"


def test_the_switch_leaves_the_libraries_alone() -> None:
    code = (
        "import pickproof, os; from pickproof.cell.numerics import profile; "
        "print(profile(), os.environ.get('MKL_CBWR'))"
    )
    assert run(code, **{numerics.SWITCH: "native"}) == "native None"


def test_training_leaves_the_profile_to_what_is_started_after_it() -> None:
    code = (
        "import pickproof, os; from pickproof.cell.numerics import fast_training, has_profile, profile\n"
        "with fast_training(): print(os.environ.get('MKL_CBWR'), end=' ')\n"
        "print(os.environ.get('MKL_CBWR'), has_profile(profile()))"
    )
    assert run(code) == "None COMPATIBLE True"


def test_a_processor_without_avx2_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(numerics.SWITCH, raising=False)
    monkeypatch.setattr(numerics, "_processor_flags", lambda: frozenset({"sse4_2", "fma"}))
    with pytest.raises(InputError, match=r"processor: 'no AVX2' is not valid; .*PICKPROOF_NUMERICS=native"):
        numerics.check_processor()
    assert numerics.profile() == numerics.NATIVE
    monkeypatch.setenv(numerics.SWITCH, "native")
    numerics.check_processor()
    monkeypatch.setenv(numerics.SWITCH, "fast")
    with pytest.raises(InputError, match="portable or native"):
        numerics.check_processor()


def test_avx512_kernels_of_opencv_are_left_out_only_where_there_are_any(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "OPENCV_CPU_DISABLE" not in {**numerics._kernels()} or "avx512f" in numerics._processor_flags()
    monkeypatch.setattr(numerics, "_processor_flags", lambda: frozenset({"avx2", "fma", "avx512f"}))
    assert numerics._kernels()["OPENCV_CPU_DISABLE"] == "AVX512-SKX"
