"""Bad files: every one gives a single error that names the file, the place, the value and the way out."""

from __future__ import annotations

import contextlib
import json
import struct
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cadcam.cad.mesh import Mesh
from cadcam.cad.read import read_model
from cadcam.cad.write import write_model
from cadcam.errors import CadcamError, DegenerateGeometry, UnreadableFile

from .solids import box

TRIANGLE = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
PLY = (
    b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    b"element face 1\nproperty list uchar int vertex_indices\nend_header\n"
)
PLY_BINARY = PLY.replace(b"ascii", b"binary_little_endian")
STL = b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
STL += b"endsolid a\n"
MODEL = (
    "<model unit='{}'><resources><object id='1'><mesh><vertices>{}</vertices><triangles>{}</triangles></mesh></object>"
)
MODEL += "</resources><build><item objectid='{}'/></build></model>"
VERTICES = "<vertex x='0' y='0' z='0'/><vertex x='1' y='0' z='0'/><vertex x='0' y='1' z='0'/>"


def whole(suffix: str, tmp_path: Path) -> bytes:
    write_model(tmp_path / f"whole{suffix}", box((0, 0, 0), (1, 2, 3)))
    return (tmp_path / f"whole{suffix}").read_bytes()


def glb(change: dict[str, object], tmp_path: Path) -> bytes:
    """Return a sound GLB with some entries of its JSON replaced."""
    return changed(whole(".glb", tmp_path), change)


def changed(data: bytes, change: dict[str, object]) -> bytes:
    size = struct.unpack_from("<I", data, 12)[0]
    text = json.dumps({**json.loads(data[20 : 20 + size]), **change}).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + size :]
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON") + text + rest


def packed(text: str, tmp_path: Path) -> bytes:
    with zipfile.ZipFile(tmp_path / "pack.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("3D/3dmodel.model", text)
    return (tmp_path / "pack.zip").read_bytes()


TEXT_CASES = [
    ("a.stl", b"", "is empty"),
    ("a.stl", b" \n\0", "is empty"),
    ("a.stl", b"abc", "3 bytes long"),
    ("a.stl", STL[:-20], "'endsolid'"),
    ("a.stl", STL.replace(b"1 0 0", b"1 O 0"), "line 5: vertex '1 O 0'"),
    ("a.stl", STL.replace(b"1 0 0", b"1 0"), "line 5"),
    ("a.stl", STL.replace(b"1 0 0", b"1 nan 0"), "line 5"),
    ("a.stl", STL.replace(b"vertex 1 0 0\n", b""), "2 corners"),
    ("a.stl", b"solid nothing\nfacet\nendsolid\n" + b" " * 60, "no geometry"),
    ("a.stl", b"\f solid a\nfacet normal 0 0 1\nendsolid", "no geometry"),
    ("a.stl", b"x" * 200, "claims 2021161080 triangles but the 200 bytes of the file hold 2 and 16 bytes more"),
    ("a.obj", b"# only words\n", "no geometry"),
    ("a.obj", b"v 0 0 0\nv 1 1 1\n", "2 vertices but no faces"),
    ("a.obj", b"v 0 0 0\nv 1 1 1\nl 1 2\n", "no faces"),
    ("a.obj", TRIANGLE.replace(b"v 1 0 0", b"v 1 x 0"), "line 2: vertex '1 x 0'"),
    ("a.obj", TRIANGLE.replace(b"v 1 0 0", b"v 1 0"), "line 2"),
    ("a.obj", TRIANGLE.replace(b"v 1 0 0", b"v 1 nan 0"), r"line 2: vertex 2 is \(1, nan, 0\)"),
    ("a.obj", TRIANGLE.replace(b"v 1 0 0", b"v 1 1e400 0"), "line 2"),
    ("a.obj", TRIANGLE.replace(b"f 1 2 3", b"f 1 2 4"), "line 4.*vertex 3, counted from 0, but the file has 3"),
    ("a.obj", TRIANGLE.replace(b"f 1 2 3", b"f 1 2 -4"), "line 4"),
    ("a.obj", TRIANGLE.replace(b"f 1 2 3", b"f 0 1 2"), "line 4: vertex number 0"),
    ("a.obj", TRIANGLE.replace(b"f 1 2 3", b"f 1 two 3"), "line 4: face '1 two 3'"),
    ("a.obj", TRIANGLE.replace(b"f 1 2 3", b"f 1 2"), "line 4: a face with 2 corners"),
    ("a.obj", TRIANGLE.replace(b"f 1 2 3", b"f 1 2 99999999999999999999"), "line 4"),
    ("a.obj", TRIANGLE.replace(b"f 1 2 3", b"f 1 2 3;4"), "line 4: face '1 2 3;4'"),
    ("a.obj", TRIANGLE.replace(b"v 1 0 0\nv 0 1 0", b"v 1 0\nv 0 1 0 1"), "line 2: vertex '1 0'"),
    ("a.obj", b"\0\1\2\3" * 50, "not OBJ text"),
    ("a.obj", TRIANGLE.replace(b"v 1 0 0", b"v 1e200 0 0"), r"line 2: vertex 2 is \(1e.200, 0, 0\)"),
    ("a.obj", TRIANGLE.replace(b"f 1 2 3", b"v 1e300 1 0\nf 1 2 4 3"), "line 4: vertex 4 is .1e.300"),
    ("a.obj", TRIANGLE.replace(b"f 1 2 3", b"v 1e999 1 0\nf 1 2 4 3"), "line 4: vertex 4 is .inf"),
    ("a.off", b"3 1 0\n", "begin with OFF"),
    ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n", "claims 3 vertices and 1 faces but 2 lines"),
    ("a.off", b"OFF\n3 one 0\n", "line 2"),
    ("a.off", b"OFF\n99999999999 1 0\n0 0 0\n", "claims 99999999999"),
    ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 q\n3 0 1 2\n", "line 5: vertex '0 1 q'"),
    ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n", "line 6.*vertex 3"),
    ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1\n", "line 6"),
    ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n-1 0 1 2\n", "line 6: a face with -1 corners"),
    ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 %d\n" % 10**30, "line 6: .* whole number in place 3"),
    ("a.off", b"OFF\n3 1 0\n0 0\n1 0\n0 1\n3 0 1 2\n", "line 3: vertex '0 0'"),
    ("a.off", b"OFF\n3 0 0\n0 0 0\n1 0 0\n0 1 0\n", "3 vertices but no faces"),
    ("a.ply", b"ply\nformat ascii 1.0\n", "no complete PLY header"),
    ("a.ply", PLY.replace(b"float y", b"flaot y"), "line 5"),
    ("a.ply", PLY.replace(b"vertex 3", b"vertex many"), "line 3"),
    ("a.ply", PLY.replace(b"property float z\n", b"") + b"0 0\n1 0\n0 1\n3 0 1 2\n", "no property 'z'"),
    ("a.ply", PLY + b"0 0 0\n1 0 0\n0 1 0\n", "claims 1 entries of 'face' but has 0"),
    ("a.ply", PLY + b"0 0 0\n1 q 0\n0 1 0\n3 0 1 2\n", "line 11: '1 q 0'"),
    ("a.ply", PLY + b"0 0 0\n1 nan 0\n0 1 0\n3 0 1 2\n", "vertex 1"),
    ("a.ply", PLY + b"0 0 0\n1 0 0\n0 1 0\n3 0 1 5\n", "face 0 refers to vertex 5"),
    ("a.ply", PLY + b"0 0 0\n1 0 0\n0 1 0\n3 0 1\n", "line 13"),
    ("a.ply", PLY + b"0 0 0\n1 0 0\n0 1 0\n3 0 1 1e30\n", "line 13: .*list of vertex numbers"),
    ("a.ply", PLY.replace(b"vertex 3", b"vertex 6") + b"0 0\n" * 6 + b"3 0 1 2\n", "line 10: '0 0' is not 3 numbers"),
    ("a.ply", PLY_BINARY.replace(b"float y", b"float x") + bytes(60), "line 5: .*'property float x'"),
    ("a.ply", PLY_BINARY.replace(b"float x", b"list uchar float x") + bytes(99), "no property 'x'"),
    ("a.ply", PLY_BINARY + bytes(20), "claims 3 entries of 'vertex', which take at least 36 bytes"),
    ("a.ply", PLY_BINARY.replace(b"vertex 3", b"vertex 4000000000") + bytes(20), "truncated"),
    ("a.ply", PLY_BINARY + bytes(36) + b"\x03" + bytes(5), "truncated"),
    ("a.ply", PLY_BINARY.replace(b"face 1", b"face 2") + bytes(36) + b"\x03" + bytes(12) + b"\xff", "truncated"),
    ("a.glb", b"glTF\2\0\0\0", "8 bytes long"),
    ("a.glb", struct.pack("<4sIII4s", b"glTF", 1, 20, 0, b"JSON"), "version 1"),
    ("a.glb", b"not a glb at all, but text", "no valid glTF JSON"),
    ("a.gltf", b"{}", "no valid glTF JSON"),
    ("a.gltf", b'{"asset": {"version": "1.0"}}', "glTF 1.0"),
    ("a.gltf", b'{"asset": {"version": "2.0"}}', "no geometry"),
    ("a.gltf", b"[" * 100_000, "no valid glTF JSON"),
    ("a.3mf", b"PK\3\4 but no more", "not a complete zip"),
    ("a.step", b"solid nonsense", "ISO-10303-21"),
    ("a.stp", b"ISO-10303-21;\nHEADER;\n", "before END-ISO-10303-21"),
    ("a.igs", b"nonsense" * 40, "IGES"),
]


@pytest.mark.parametrize(("name", "data", "words"), TEXT_CASES, ids=[f"{i}-{c[0]}" for i, c in enumerate(TEXT_CASES)])
def test_a_bad_file_is_refused_with_its_place(tmp_path: Path, name: str, data: bytes, words: str) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(UnreadableFile, match=words) as caught:
        read_model(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".glb"])
@pytest.mark.parametrize("share", [0.05, 0.3, 0.6, 0.9, 0.99])
def test_a_file_cut_short_anywhere_is_refused(tmp_path: Path, suffix: str, share: float) -> None:
    data = whole(suffix, tmp_path)
    (tmp_path / f"cut{suffix}").write_bytes(data[: int(share * len(data))])
    with pytest.raises(UnreadableFile, match=f"cut{suffix}"):
        read_model(tmp_path / f"cut{suffix}")


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj", ".off", ".glb", ".3mf"])
def test_random_damage_never_escapes_as_another_error(tmp_path: Path, suffix: str, rng: np.random.Generator) -> None:
    if suffix == ".3mf":
        data = packed(MODEL.format("inch", VERTICES, "<triangle v1='0' v2='1' v3='2'/>", 1), tmp_path)
    elif suffix == ".off":
        data = b"OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n3 0 2 3\n"
    else:
        data = whole(suffix, tmp_path)
    for _ in range(150):
        broken = bytearray(data)
        for at in rng.integers(0, len(data), 4):
            broken[at] = rng.integers(0, 256)
        (tmp_path / f"broken{suffix}").write_bytes(broken)
        with contextlib.suppress(CadcamError):
            read_model(tmp_path / f"broken{suffix}")


GLB_CASES: list[tuple[dict[str, object], str]] = [
    ({"nodes": [{"mesh": 0, "children": [0]}]}, "stands twice"),
    ({"nodes": [{"mesh": 9}]}, "inconsistent"),
    ({"accessors": []}, "inconsistent"),
    ({"accessors": [{"bufferView": 0, "componentType": 5126, "count": 10**9, "type": "VEC3"}] * 2}, "truncated"),
    ({"accessors": [{"bufferView": 0, "componentType": 5126, "count": -1, "type": "VEC3"}] * 2}, "accessor 0"),
    ({"accessors": [{"bufferView": 0, "componentType": 5126, "count": 1e999, "type": "VEC3"}] * 2}, "inconsistent"),
    ({"accessors": [{"componentType": 5126, "count": 10**14, "type": "VEC3"}] * 2}, "accessor . has no data"),
    (
        {"accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC2"}] * 2},
        "2 numbers a vertex",
    ),
    ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, "draco"),
    ({"extensionsRequired": ["EXT_mesh_gpu_instancing"]}, "needs the extension EXT_mesh_gpu_instancing"),
    ({"nodes": [{"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {}}}]}, "places its mesh many times"),
    ({"buffers": [{"byteLength": 4, "uri": "../secret.bin"}]}, "outside its own folder"),
    ({"buffers": [{"byteLength": 4, "uri": "gone.bin"}]}, "gone.bin: cannot be read"),
    ({"meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "mode": 0}]}]}, "no geometry"),
]


@pytest.mark.parametrize(("change", "words"), GLB_CASES, ids=[w for _, w in GLB_CASES])
def test_a_glb_that_contradicts_itself_is_refused(tmp_path: Path, change: dict[str, object], words: str) -> None:
    (tmp_path / "a.glb").write_bytes(glb(change, tmp_path))
    with pytest.raises(UnreadableFile, match=words):
        read_model(tmp_path / "a.glb")


LOOKS = {"extensionsRequired": ["KHR_texture_transform", "KHR_materials_unlit", "KHR_mesh_quantization"]}


@pytest.mark.parametrize("change", [{"asset": {"version": "2.0", "extras": ["any"]}}, {"extensionsRequired": 5}, LOOKS])
def test_a_glb_may_hold_what_nobody_asked_for(tmp_path: Path, change: dict[str, object]) -> None:
    (tmp_path / "a.glb").write_bytes(glb(change, tmp_path))
    assert read_model(tmp_path / "a.glb").n_faces == 12


def test_a_node_scaled_to_nothing_hides_only_itself(tmp_path: Path) -> None:
    """Animations hide a node so; its normals have no inverse to be turned by."""
    normals = np.tile(np.float32([0, 0, 1]), (12, 3, 1))
    write_model(tmp_path / "whole.glb", replace(box((0, 0, 0), (1, 2, 3)), corner_normals=normals))
    data = (tmp_path / "whole.glb").read_bytes()
    nodes = {"nodes": [{"mesh": 0}, {"mesh": 0, "scale": [0, 0, 0]}], "scenes": [{"nodes": [0, 1]}]}
    (tmp_path / "a.glb").write_bytes(changed(data, nodes))
    assert read_model(tmp_path / "a.glb").n_faces == 12


@pytest.mark.parametrize("end", [b"\n", b"\r\n", b"\r"])
def test_an_ascii_stl_is_read_whatever_its_names_and_line_ends(tmp_path: Path, end: bytes) -> None:
    text = STL.replace(b"solid a", b"solid a vertex of facets").replace(b"\n", end)
    (tmp_path / "a.stl").write_bytes(text)
    mesh = read_model(tmp_path / "a.stl")
    assert (mesh.n_faces, mesh.part_names) == (1, ("a vertex of facets",))
    (tmp_path / "a.stl").write_bytes(text.replace(b"1 0 0", b"1 O 0"))
    with pytest.raises(UnreadableFile, match="line 5: vertex '1 O 0'"):
        read_model(tmp_path / "a.stl")


MODEL_CASES = [
    (MODEL.format("parsec", VERTICES, "", 1), "unit 'parsec'"),
    (MODEL.format("inch", VERTICES, "<triangle v1='0' v2='1' v3='7'/>", 1), "triangle 0 refers to vertex 7"),
    (MODEL.format("inch", VERTICES, "<triangle v1='0' v2='one' v3='2'/>", 1), "number it should not"),
    (MODEL.format("inch", VERTICES, "<triangle v1='0' v2='1'/>", 1), "number it should not"),
    (MODEL.format("inch", VERTICES, "", 1), "no geometry"),
    (MODEL.format("inch", VERTICES, "", 5), "object '5'"),
    ("<model><resources>", "not valid XML"),
]


@pytest.mark.parametrize(("text", "words"), MODEL_CASES, ids=[w for _, w in MODEL_CASES])
def test_a_3mf_that_contradicts_itself_is_refused(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "a.3mf").write_bytes(packed(text, tmp_path))
    with pytest.raises(UnreadableFile, match=words):
        read_model(tmp_path / "a.3mf")


def test_a_3mf_of_components_of_components_is_refused_before_it_fills_the_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ten of ten of ten ...: a kilobyte of XML that places a hundred million objects."""
    monkeypatch.setattr("cadcam.cad.formats.threemf._MOST", 1000)
    level = "<object id='{}'><components>" + 10 * "<component objectid='{}'/>" + "</components></object>"
    levels = "".join(level.format(n, *[n - 1] * 10) for n in range(2, 10))
    text = MODEL.format("inch", VERTICES, "<triangle v1='0' v2='1' v3='2'/>", 9)
    text = text.replace("</resources>", levels + "</resources>")
    (tmp_path / "a.3mf").write_bytes(packed(text, tmp_path))
    with pytest.raises(UnreadableFile, match="more than 1000 objects"):
        read_model(tmp_path / "a.3mf")


def test_a_3mf_cut_short_is_refused(tmp_path: Path) -> None:
    data = packed(MODEL.format("inch", VERTICES, "", 1), tmp_path)
    (tmp_path / "a.3mf").write_bytes(data[:-30])
    with pytest.raises(UnreadableFile, match="zip archive"):
        read_model(tmp_path / "a.3mf")


def test_a_folder_a_missing_file_and_an_unknown_suffix_are_told_apart(tmp_path: Path) -> None:
    write_model(tmp_path / "plate.stl", box((0, 0, 0), (1, 1, 1)))
    (tmp_path / "plate.stlx").write_bytes(b"x")
    (tmp_path / "plate").write_bytes(b"x")
    for name, words in (
        (".", "is a folder"),
        ("plate.slt", r"does not exist; did you mean 'plate\.stl'\?"),
        ("plate.stlx", r"'\.stlx', which no CAD reader knows; did you mean \.stl\?"),
        ("plate", "has no suffix"),
    ):
        with pytest.raises(UnreadableFile, match=words):
            read_model(tmp_path / name)


def test_faces_without_area_are_refused_with_the_file(tmp_path: Path) -> None:
    flat = Mesh.single([(0, 0, 0), (1, 1, 1), (2, 2, 2), (3, 3, 3)], [(0, 1, 2), (1, 2, 3)])
    write_model(tmp_path / "flat.ply", flat)
    with pytest.raises(DegenerateGeometry, match=r"flat\.ply: every face has zero area"):
        read_model(tmp_path / "flat.ply")


def test_a_step_file_that_cannot_be_converted_gives_one_error_and_no_chatter(tmp_path: Path) -> None:
    pytest.importorskip("cascadio")
    path = tmp_path / "empty.step"
    path.write_text("ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\n#1=NONSENSE(\nENDSEC;\nEND-ISO-10303-21;\n")
    code = (
        "from cadcam.cad.read import read_model; from cadcam.errors import UnreadableFile\n"
        f"try: read_model({str(path)!r})\nexcept UnreadableFile as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    assert done.stdout.startswith(f"{path}: ")
    assert done.stdout.count("\n") == 1


OFF = b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
TEXTS = {".obj": TRIANGLE, ".off": OFF, ".stl": STL, ".ply": PLY + b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"}


@pytest.mark.parametrize("suffix", TEXTS)
def test_a_byte_order_mark_is_no_part_of_a_text_file(suffix: str, tmp_path: Path) -> None:
    """Taken for part of the first word, it makes an OBJ file lose its first vertex."""
    path = tmp_path / f"marked{suffix}"
    path.write_bytes(b"\xef\xbb\xbf" + TEXTS[suffix])
    assert read_model(path).size_mm.tolist() == [1, 1, 0]
    path.write_bytes(TEXTS[suffix].decode().encode("utf-16"))
    with pytest.raises(UnreadableFile, match="is text in UTF-16; save it as UTF-8 or ASCII"):
        read_model(path)


@pytest.mark.parametrize("suffix", [".obj", ".off", ".stl"])
def test_decimal_commas_are_recognised(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"komma{suffix}"
    path.write_bytes(TEXTS[suffix].replace(b"1 0 0\n", b"1,5 0,0 0,0\n", 1))
    with pytest.raises(UnreadableFile, match=r"'1,5 0,0 0,0' is not three.* numbers; write decimal points, not commas"):
        read_model(path)
