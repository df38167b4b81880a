"""The one place that imports open3d.

Its wheel links to libusb-1.0.so.0, which a bare machine lacks. `libusb-package` ships that library under the same
SONAME; once loaded with RTLD_GLOBAL the dynamic linker takes it, and no root is needed.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

import libusb_package


def load_open3d() -> ModuleType:
    """Import open3d (0.5 s), so only where rays are cast or clouds are drawn."""
    path = libusb_package.get_library_path()
    if path is not None:
        ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
    with _without_dash():
        import open3d

    return open3d


@contextmanager
def _without_dash() -> Iterator[None]:
    """Open3D imports a web server, for a function that draws in a page, and that takes longer than all the rest."""
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
