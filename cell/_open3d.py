"""The one place that imports open3d.

Its wheel links to libusb-1.0.so.0, which a bare machine lacks. `libusb-package` ships that library under the same
SONAME; once loaded with RTLD_GLOBAL the dynamic linker takes it, and no root is needed.
"""

from __future__ import annotations

import ctypes
from types import ModuleType

import libusb_package


def load_open3d() -> ModuleType:
    """Import open3d (0.9 s), so only where rays are cast or clouds are drawn."""
    path = libusb_package.get_library_path()
    if path is not None:
        ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
    import open3d

    return open3d
