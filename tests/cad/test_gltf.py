"""glTF: numbers that point beyond what is there are refused, not counted from the end; sparse accessors are read."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cadcam.cad.read import read_model
from cadcam.errors import UnreadableFile

CORNERS = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], "<f4")
Change = Callable[[dict[str, Any]], object]


def square() -> dict[str, Any]:
    """Return a unit square in metres: its corners, two triangles, and a far corner to replace its third with."""
    data = CORNERS.tobytes() + bytes([0, 1, 2, 0, 2, 3, 2, 0]) + struct.pack("<3f", 3, 3, 0)
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [{}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5121, "count": 6, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 6},
            {"buffer": 0, "byteOffset": 54, "byteLength": 2},
            {"buffer": 0, "byteOffset": 56, "byteLength": 12},
        ],
        "buffers": [
            {
                "byteLength": len(data),
                "uri": "data:application/octet-stream;base64," + base64.b64encode(data).decode(),
            }
        ],
    }


def sparse(**indices: int) -> dict[str, Any]:
    place = {"bufferView": 2, "componentType": 5121, **indices}
    return {"sparse": {"count": 1, "indices": place, "values": {"bufferView": 3}}}


def corners(tmp_path: Path, change: Change) -> list[list[float]]:
    """Return the vertices in mm of the square, changed."""
    text = square()
    change(text)
    (tmp_path / "a.gltf").write_text(json.dumps(text))
    return read_model(tmp_path / "a.gltf").vertices.tolist()


def test_a_sparse_accessor_replaces_what_it_names(tmp_path: Path) -> None:
    far = corners(tmp_path, lambda g: g["accessors"][0].update(sparse()))
    assert corners(tmp_path, lambda g: None) == (1000 * CORNERS).tolist()
    assert far == [[0, 0, 0], [1000, 0, 0], [3000, 3000, 0], [0, 1000, 0]]


CASES: dict[str, tuple[Change, str]] = {
    "scene": (lambda g: g.update(scene=-1), "scenes -1"),
    "node": (lambda g: g["scenes"][0].update(nodes=[-1]), "nodes -1"),
    "mesh": (lambda g: g["nodes"][0].update(mesh=-1), "meshes -1"),
    "material": (lambda g: g["meshes"][0]["primitives"][0].update(material=-1), "materials -1"),
    "accessor": (lambda g: g["meshes"][0]["primitives"][0].update(indices=-1), "accessors -1"),
    "view": (lambda g: g["accessors"][1].update(bufferView=-3), "bufferViews -3"),
    "buffer": (lambda g: g["bufferViews"][0].update(buffer=-1), "buffers -1"),
    "offset": (lambda g: g["accessors"][1].update(byteOffset=-1), "accessor 1 claims 6 entries"),
    "view's offset": (
        lambda g: (g["bufferViews"][1].update(byteOffset=-2), g["accessors"][1].update(byteOffset=50)),
        "accessor 1 claims 6 entries",
    ),
    "beyond the view": (lambda g: g["accessors"][1].update(count=8), "up to byte 56 of a buffer view that ends at 54"),
    "replaced": (lambda g: g["accessors"][0].update(sparse(byteOffset=-2)), "accessor 0 claims 1 entries"),
    "replaced beyond the end": (
        lambda g: (g["accessors"][0].update(sparse()), g["accessors"][0].update(count=2)),
        "accessor 0 replaces entries 2 to 2 of 2",
    ),
}


@pytest.mark.parametrize(("change", "words"), CASES.values(), ids=CASES)
def test_a_number_of_nothing_is_refused(tmp_path: Path, change: Change, words: str) -> None:
    with pytest.raises(UnreadableFile, match=words):
        corners(tmp_path, change)


def test_a_signed_number_of_a_vertex_is_not_counted_from_the_end(tmp_path: Path) -> None:
    """In a second primitive it would be a vertex of the first."""

    def change(g: dict[str, Any]) -> None:
        g["accessors"].append({"bufferView": 2, "componentType": 5120, "count": 3, "type": "SCALAR"})
        g["meshes"][0]["primitives"].append({"attributes": {"POSITION": 0}, "indices": 2})
        g["buffers"].append({"byteLength": 3, "uri": "data:;base64," + base64.b64encode(bytes([255, 1, 2])).decode()})
        g["bufferViews"][2] = {"buffer": 1, "byteLength": 3}

    with pytest.raises(UnreadableFile, match="accessor 2, entry 0 refers to vertex -1 of 4"):
        corners(tmp_path, change)
