"""The only module that imports open3d.

Its wheel links to libusb-1.0.so.0, which a bare machine lacks. `libusb-package` ships that library under the same
SONAME. Once it is loaded with RTLD_GLOBAL, the dynamic linker uses it; root rights are not needed.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

import libusb_package


def load_open3d() -> ModuleType:
    """Import open3d when it is needed, because the import takes 0.5 s."""
    path = libusb_package.get_library_path()
    if path is not None:
        ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
    with _without_dash():
        import open3d

    return open3d


@contextmanager
def _without_dash() -> Iterator[None]:
    """Replace dash, a web server that Open3D imports for notebooks, by an empty module: it takes most of the import
    time.
    """
    if "dash" in sys.modules:
        yield
        return
    stand_in = ModuleType("dash")
    stand_in.__dict__.update(html=None, dcc=None, Dash=None)
    sys.modules["dash"] = stand_in
    try:
        yield
    finally:
        del sys.modules["dash"]
