"""What a GLB or a STEP file declares of itself, compared before and after trimesh reads it."""

from __future__ import annotations

import json
import struct
from io import BytesIO
from typing import Any

import numpy as np
import trimesh

from pickproof.cell.mesh.error import MeshError
from pickproof.cell.mesh.raw import RawMesh, cut_short, padding

MAGIC, JSON, BIN = 0x46546C67, 0x4E4F534A, 0x004E4942
BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
TRIANGLES, STRIP, FAN = 4, 5, 6
COMPRESSED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")
STEP_ENDS = (b"ISO-10303-21;", b"END-ISO-10303-21;")


def read_glb(data: bytes) -> RawMesh:
    """The surface of a glTF 2.0 in one file.

    Raises:
        MeshError: it is cut short, asks for what is not in it, or less was read than it declares.
    """
    tree, notes = _chunks(data)
    try:
        declared = _check_tree(tree)
    except (KeyError, IndexError, TypeError, ValueError, AttributeError):
        raise MeshError("a JSON chunk that is no glTF 2.0", "a GLB file") from None
    scene = _loaded(data, "glb", skip_materials=True, process=False)
    found = sum(len(g.faces) for g in scene.geometry.values() if isinstance(g, trimesh.Trimesh))
    if declared >= 0 and found != declared:
        raise MeshError(f"{found} of {declared} declared triangles were read", "all of them; export it again")
    return _joined(scene, notes)


def read_step(data: bytes) -> RawMesh:
    """The surface of a STEP file in [m], made triangles by its library.

    Raises:
        MeshError: it is not STEP, cut short, or without a surface.
    """
    text = data.strip(b"\0 \t\r\n")
    begin, end = STEP_ENDS
    if not text.startswith(begin):
        raise MeshError(f"a file that does not begin with {begin.decode()}", "a STEP file")
    if not text.endswith(end):
        raise MeshError(f"no {end.decode()} at the end: the file was cut short", "all of it; export it again")
    return _joined(_loaded(data, "step"), ())


def _loaded(data: bytes, kind: str, **options: Any) -> Any:
    try:
        return trimesh.load(BytesIO(data), file_type=kind, force="scene", **options)
    except MemoryError:
        raise
    except Exception as error:  # noqa: BLE001  trimesh's readers raise whatever their parsers raise
        said = " ".join(str(error).split())[:80] or type(error).__name__
        raise MeshError(f"a file that its reader refuses ({said})", f"a readable {kind.upper()} file") from None


def _joined(scene: Any, notes: tuple[str, ...]) -> RawMesh:
    """Everything in a scene where it stands."""
    mesh = scene.to_mesh() if len(scene.geometry) else None
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise MeshError("no faces", "a mesh with faces")
    return RawMesh(np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64), notes)


def _chunks(data: bytes) -> tuple[dict[str, Any], tuple[str, ...]]:
    """The tree of the JSON chunk; lengths are compared with the file."""
    if len(data) < 20 or struct.unpack_from("<II", data) != (MAGIC, 2):
        raise MeshError("no header of a binary glTF 2.0", "a GLB file")
    length = struct.unpack_from("<I", data, 8)[0]
    if length > len(data):
        raise cut_short(len(data), length, "bytes")
    notes = padding(data[length:], f"{length} declared bytes")
    at, chunks = 12, dict[int, bytes]()
    while at + 8 <= length:
        size, kind = struct.unpack_from("<II", data, at)
        if at + 8 + size > length:
            raise cut_short(length - at - 8, size, "bytes of a chunk")
        chunks.setdefault(kind, data[at + 8 : at + 8 + size])
        at += 8 + size
    try:
        tree = json.loads(chunks[JSON])
        assert isinstance(tree, dict)
    except (KeyError, ValueError, AssertionError, RecursionError):
        raise MeshError("a JSON chunk that cannot be read", "a GLB file") from None
    return tree | {"_bin": len(chunks.get(BIN, b""))}, notes


def _check_tree(tree: dict[str, Any]) -> int:
    """Number of triangles that the meshes declare, -1 where strips make it unknown; every view must lie in the file."""
    needed = [name for name in COMPRESSED if name in tree.get("extensionsRequired", [])]
    if needed:
        raise MeshError(f"a mesh compressed with {needed[0]}", "a GLB file without compression")
    if any("uri" in buffer and not buffer["uri"].startswith("data:") for buffer in tree.get("buffers", [])):
        raise MeshError("a buffer in another file", "a GLB file with all of its data")
    views = tree.get("bufferViews", [])
    for i, view in enumerate(views):
        end = view.get("byteOffset", 0) + view["byteLength"]
        if "uri" not in tree["buffers"][view["buffer"]] and not view["byteLength"] <= end <= tree["_bin"]:
            raise MeshError(f"view {i} to byte {end} of {tree['_bin']}", "a file that holds its data; export it again")
    accessors = tree.get("accessors", [])
    for i, accessor in enumerate(accessors):
        if "sparse" in accessor:
            raise MeshError(f"accessor {i} is sparse", "a GLB file with plain accessors")
        if "bufferView" in accessor:
            _check_accessor(i, accessor, views[accessor["bufferView"]])
    total = 0
    for primitive in (p for mesh in tree.get("meshes", []) for p in mesh["primitives"]):
        mode = primitive.get("mode", TRIANGLES)
        if mode == FAN:
            raise MeshError("triangle fans, which cannot be read", "a GLB file of triangles")
        if mode == STRIP or total < 0:
            total = -1
        elif mode == TRIANGLES:
            total += accessors[primitive.get("indices", primitive["attributes"]["POSITION"])]["count"] // 3
    return total


def _check_accessor(i: int, accessor: dict[str, Any], view: dict[str, Any]) -> None:
    item = BYTES[accessor["componentType"]] * WIDTHS[accessor["type"]]
    count, start = accessor["count"], accessor.get("byteOffset", 0)
    if not (isinstance(count, int) and count >= 0 and start >= 0):
        raise ValueError
    end = start + (count - 1) * view.get("byteStride", item) + item
    if count and end > view["byteLength"]:
        raise MeshError(f"accessor {i} of {count} declared items needs {end} of {view['byteLength']} bytes",
                        "a file that holds its data; export it again")  # fmt: skip
