"""One numeric profile: the same seed gives the same picks on every processor with AVX2.

Libraries choose their kernels by the processor, and each kernel adds in its own order. In a heap of workpieces a
difference in the last bit grows to a different pick. This module fixes the kernels by environment variables that the
libraries read when they are loaded; importing `pickproof` sets them first. Child processes inherit them. What no
variable fixes is computed by portable code (`cell/geometry/ray_hits.py`).

With `PICKPROOF_NUMERICS=native` the libraries choose their kernels. A campaign records the profile.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from pickproof.cell.errors import InputError

SWITCH = "PICKPROOF_NUMERICS"
"""Environment variable: `portable` (default) or `native`."""
PORTABLE, NATIVE = "portable-1", "native"
"""Names of the profiles as they are recorded; the number rises when the same seed gives other results."""

_KERNELS = {
    "OPENBLAS_CORETYPE": "Haswell",  # matrix products of numpy and scipy: AVX2 with FMA, on every maker's processors
    "OPENBLAS_NUM_THREADS": "1",  # sums over threads depend on their number
    # numpy at its x86-64-v2 baseline: argsort with AVX-512 and with AVX2 order equal elements differently
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR",
    # MKL, in torch: the only mode that Intel documents for processors of other makers. Not even it fixes the square
    # root of a vector (torch.sqrt), which uses the processor's own estimate of 1 / sqrt: nothing here calls it
    "MKL_CBWR": "COMPATIBLE",
    "ATEN_CPU_CAPABILITY": "avx2",  # torch's own loops
    "ONEDNN_MAX_CPU_ISA": "AVX2",
    "OPENCV_IPP": "avx2",
    "NUMBA_CPU_NAME": "haswell",
    "NUMBA_CPU_FEATURES": "",
}
_LIBRARIES = ("numpy", "scipy", "torch", "cv2", "numba")
_late = False


def use_portable_kernels() -> None:
    """Fix the kernels of this process and of its children; libraries that are loaded already keep theirs."""
    global _late
    if not _is_portable_wanted() or missing_instructions():
        return
    kernels = _kernels()
    if any(name in sys.modules for name in _LIBRARIES):
        _late = any(os.environ.get(name) != value for name, value in kernels.items())
    os.environ.update(kernels)


@contextmanager
def fast_training() -> Iterator[None]:
    """Let MKL choose its kernels, for training speed. Processes started later keep the numeric profile.

    MKL reads its variable at its first matrix product; later changes have no effect on this process.
    """
    before = os.environ.pop("MKL_CBWR", None)
    try:
        yield
    finally:
        if before is not None:
            os.environ["MKL_CBWR"] = before


def profile() -> str:
    """Name of the profile of the processes that this one starts."""
    return PORTABLE if _is_portable_wanted() and not missing_instructions() else NATIVE


def has_profile(name: str) -> bool:
    """Whether this process computes by the profile `name`."""
    return name == profile() and not (name == PORTABLE and (_late or _differs()))


def check_processor() -> None:
    """Check the processor before a campaign.

    Raises:
        InputError: the processor cannot reproduce results of other machines, and the `native` profile is not set.
    """
    wanted = os.environ.get(SWITCH, "portable")
    if wanted not in ("portable", "native"):
        raise InputError("environment", SWITCH, wanted, "portable or native")
    missing = missing_instructions()
    if wanted == "portable" and missing:
        valid = f"x86-64 with AVX2 and FMA; set {SWITCH}=native to run with results that differ from other machines"
        raise InputError("this machine", "processor", f"no {', '.join(missing)}", valid)


def missing_instructions() -> list[str]:
    """Instructions of the portable profile that the processor lacks."""
    flags = _processor_flags()
    return [name.upper() for name in ("avx2", "fma") if name not in flags]


def _is_portable_wanted() -> bool:
    return os.environ.get(SWITCH, "portable") != "native"


def _differs() -> bool:
    return any(os.environ.get(name) != value for name, value in _kernels().items())


def _kernels() -> dict[str, str]:
    # OpenCV writes a warning if a feature is disabled that the processor lacks
    return _KERNELS | ({"OPENCV_CPU_DISABLE": "AVX512-SKX"} if "avx512f" in _processor_flags() else {})


@cache
def _processor_flags() -> frozenset[str]:
    """Feature flags of the first processor, from /proc/cpuinfo; empty on other systems."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return frozenset()
    return frozenset(next((line.partition(":")[2].split() for line in lines if line.startswith("flags")), []))
