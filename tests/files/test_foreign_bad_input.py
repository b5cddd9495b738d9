"""Files that are cut, corrupt, hostile or from the future: one clear error, never anything else."""

from __future__ import annotations

import random
import re
import struct
from pathlib import Path

import numpy as np
import pytest

from cadcam.camera.camera import Camera
from cadcam.errors import CadcamError, UnknownName, UnreadableFile
from cadcam.files.foreign import source as source_module
from cadcam.files.foreign.model import Format
from cadcam.files.foreign.registry import NAMES, format_named, read_cameras, write_cameras
from cadcam.geometry.rigid import Rigid

from .foreign_cameras import lenses_held, random_camera

SPLICES = [
    *(
        b"nan",
        b"inf",
        b"1e999",
        b"1e308",
        b"-1",
        b"0",
        b"1e-320",
        b"null",
        b"true",
        b'"x"',
        b"[]",
        b"{}",
        b"\xff",
        b"\0",
    ),
    *(
        b"{",
        b"[",
        b"]",
        b"}",
        b'"',
        b"<a>",
        b"&",
        b":",
        b"\n",
        b"\\ud800",
        b"9" * 400,
        b"9" * 5000,
        b"((((" * 50,
        b"[" * 500,
    ),
]


def damaged(data: bytes, chance: random.Random) -> bytes:
    """The data cut short, with bytes flipped, pieces lost, repeated or spliced in, or a number replaced."""
    out = bytearray(data)
    at = chance.randrange(len(out))
    kind = chance.randrange(6)
    if kind == 0:
        return bytes(out[:at])
    if kind == 1:
        for _ in range(chance.randrange(1, 4)):
            out[chance.randrange(len(out))] = chance.randrange(256)
    elif kind == 2:
        del out[at : at + chance.randrange(1, 20)]
    elif kind == 3:
        out[at:at] = out[at : at + chance.randrange(1, 40)]
    elif kind == 4:
        out[at:at] = chance.choice(SPLICES)
    else:
        found = chance.choice([*re.finditer(rb"[-+]?\d+\.?\d*(e[-+]?\d+)?", data)] or [re.match(b"", data)])
        assert found is not None
        out[found.start() : found.end()] = chance.choice(SPLICES)
    return bytes(out)


def samples(folder: Path, form: Format) -> list[dict[str, bytes]]:
    """Sound files of a format, content by name; "" is the file itself."""
    rng, out = np.random.default_rng(5), []
    for i, lens in enumerate(lenses_held(rng, form.holds)[:5]):
        path = folder / f"{form.name}_{i}{form.suffixes[0] if form.suffixes else ''}"
        camera, pose = random_camera(rng, lens, holds=form.holds), Rigid.look_at([300, -200, 900], [1, 2, 3])
        written = write_cameras(path, camera, format_name=form.name, camera_from_world=pose)
        names = [Path(p).name if form.folder or p != str(path) else "" for p in written.paths]
        out.append({name: Path(p).read_bytes() for name, p in zip(names, written.paths, strict=True)})
    return out


@pytest.mark.parametrize("name", NAMES)
def test_whatever_is_done_to_a_file_only_a_cadcam_error_comes_out(tmp_path: Path, name: str) -> None:
    """Warnings are errors here, so nothing is read with a shrug either. 80 damages a file, a fixed seed."""
    from cadcam.files.foreign import registry
    from cadcam.files.foreign.source import ForeignFile

    form, chance = format_named(name), random.Random(20261121)
    said: list[str] = []
    for files in samples(tmp_path, form):
        for _ in range(80):
            hit = chance.choice([n for n in files if not n.startswith("points3D")])
            source = ForeignFile(str(tmp_path / "x"), memory={**files, hit: damaged(files[hit], chance)})
            for choose in (lambda s: form, registry.format_of):
                try:
                    registry._read(choose(source), source)
                except CadcamError as error:
                    said.append(str(error))
    assert len(said) > 50  # the damage is real
    assert not [text for text in said if "\n" in text or len(text) > 1200]


@pytest.mark.parametrize("name", NAMES)
def test_every_file_cut_off_is_refused_with_its_name(tmp_path: Path, name: str) -> None:
    form = format_named(name)
    path = tmp_path / f"cut{form.suffixes[0] if form.suffixes else ''}"
    pose = Rigid.look_at([300, -200, 900], [1, 2, 3])
    written = write_cameras(path, Camera.from_focal((640, 480), 500.5), format_name=name, camera_from_world=pose)
    first = Path(written.paths[0])
    first.write_bytes(first.read_bytes()[: int(0.3 * len(first.read_bytes()))])
    with pytest.raises(UnreadableFile) as caught:
        read_cameras(path, format_name=name)
    assert path.name in str(caught.value)


def test_a_future_version_of_our_file_says_so_before_anything_else(tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    path.write_text('{"format": "cadcam camera", "version": 7, "size_px": [640, 480], "spectral_K": [1, 2, 3]}')
    with pytest.raises(UnreadableFile, match=r"has version 7; this cadcam \(.*\) reads version 1; use a newer one"):
        read_cameras(path)


FUTURE = {
    "c.gltf": (
        '{"asset": {"version": "3.0"}, "cameras": [{"type": "perspective"}]}',
        "is glTF 3.0; version 2 is read here",
    ),
    "c.usda": ('#usda 2.0\ndef Camera "c" {}\n', "says '#usda 2.0'; version 1"),
    "c.xml": (
        '<document version="3.1"><sensors><sensor><calibration/></sensor></sensors></document>',
        "is of version '3.1'",
    ),
}


@pytest.mark.parametrize("name", FUTURE)
def test_a_future_version_of_other_formats_is_refused(tmp_path: Path, name: str) -> None:
    text, message = FUTURE[name]
    (tmp_path / name).write_text(text)
    with pytest.raises(UnreadableFile, match=re.escape(message)):
        read_cameras(tmp_path / name)


def test_a_huge_file_is_not_even_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source_module, "MAX_BYTES", 1000)
    (tmp_path / "c.yml").write_bytes(b"%YAML:1.0\n" + b"#" * 2000)
    with pytest.raises(UnreadableFile, match="is 2010 bytes long, more than 1000; is it the right file"):
        read_cameras(tmp_path / "c.yml")


@pytest.mark.parametrize("filler", [b"9", b"\n", b" ", b"(", b"CAMERA = {\n", b"a: ", b"<a>", b'"'])
def test_a_quarter_megabyte_of_nothing_is_refused_without_pondering(tmp_path: Path, filler: bytes) -> None:
    """No pattern may go back and forth over it: quadratic would be minutes here, not the suite's seconds."""
    for name in NAMES:
        form = format_named(name)
        for files in samples(tmp_path, form)[:1]:
            hit = next(iter(files))
            middle = len(files[hit]) // 2
            (tmp_path / "x").write_bytes(files[hit][:middle] + filler * (250_000 // len(filler)) + files[hit][middle:])
            with pytest.raises(CadcamError):
                read_cameras(tmp_path / "x", format_name=name, size=(640, 480))


OPENCV_HEAD = "%YAML:1.0\nimage_width: 640\nimage_height: 480\n"
HOSTILE = {
    "entities.xml": (
        '<?xml version="1.0"?><!DOCTYPE lolz [<!ENTITY a "aaaaaaaa"><!ENTITY b "&a;&a;&a;">]>'
        "<root><camera><model><type>perspectiveProjWithoutDistortion</type>&b;</model></camera></root>",
        "declares a document type or entities",
    ),
    "anchors.yaml": ("cam0: &a\n  camera_model: pinhole\ncam1: *a\n", "line 1 uses anchors"),
    "deep.yaml": ("cam0: " + "[" * 60 + "]" * 60 + "\ncamera_model: x\n", "nested more than 40 deep"),
    "tagged.yaml": ("cam0: !!python/object/apply:os.system ['true']\ncamera_model: x\n", "is "),
    "twice.yaml": ("cam0:\n  camera_model: pinhole\n  camera_model: omni\n", "line 3 has the key 'camera_model' twice"),
    "code.cameramodel": ("{'lensmodel': 'LENSMODEL_PINHOLE', 'intrinsics': __import__('os').getpid()}", "plain values"),
    "nan.yml": (
        f"{OPENCV_HEAD}camera_matrix: !!opencv-matrix\n  rows: 3\n  cols: 3\n  dt: d\n"
        "  data: [ .Nan, 0., 3., 0., 5., 2., 0., 0., 1. ]\n",
        "camera_matrix.data is not finite",
    ),
    "sizes.yml": (
        f"{OPENCV_HEAD}camera_matrix: !!opencv-matrix\n  rows: 3\n  cols: 3\n  dt: d\n"
        "  data: [ 5., 0., 3., 0., 5., 2., 0., 0. ]\n",
        r"is 3 x 3 with 8 numbers",
    ),
    "mirrored.json": (
        '{"fl_x": 500, "w": 640, "h": 480, "frames": '
        '[{"transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,-1,0],[0,0,0,1]]}]}',
        "mirrored",
    ),
    "tilted.dat": ("ParGroup: Camera: Parameter;\nFocus:foc: 0.01;\nTilt:tilt: 3;\n", "read here: area scan cameras"),
    "p3.xml": (
        '<document version="2.0.0"><chunk><sensors><sensor id="0"><resolution width="640" height="480"/><calibration>'
        "<f>500</f><p3>0.1</p3></calibration></sensor></sensors></chunk></document>",
        "has p3, which no lens here has",
    ),
    "half.xml": (
        '<document version="2.0.0"><chunk><sensors><sensor id="0"><resolution width="640.5" height="480"/><calibration>'
        "<f>500</f></calibration></sensor></sensors></chunk></document>",
        "has width 640.5.*a whole number is expected",
    ),
    "splined.cameramodel": (
        "{'lensmodel': 'LENSMODEL_SPLINED_STEREOGRAPHIC_order=3'}",
        "mrcal-convert-lensmodel helps",
    ),
    "omni.yaml": (
        "cam0:\n  camera_model: omni\n  intrinsics: [0.8, 700, 700, 320, 240]\n  distortion_model: radtan\n"
        "  distortion_coeffs: [0.1, 0, 0, 0]\n  resolution: [640, 480]\n",
        "combines omni with radtan",
    ),
    "letter.txt": (
        "Dear Sir or Madam,\nplease find enclosed\n",
        "no camera file known by its content; name its format",
    ),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_and_unsupported_content_is_refused_with_the_reason(tmp_path: Path, name: str) -> None:
    text, message = HOSTILE[name]
    (tmp_path / name).write_text(text)
    with pytest.raises(UnreadableFile, match=message) as caught:
        read_cameras(tmp_path / name)
    assert str(caught.value).startswith(str(tmp_path / name))


def test_an_unknown_colmap_model_names_the_known_ones(tmp_path: Path) -> None:
    (tmp_path / "cameras.txt").write_text("1 THIN_PRISM_FISHEYE 640 480 500 500 320 240 0 0 0 0 0 0 0 0\n")
    with pytest.raises(
        UnreadableFile, match=r"line 1 names an unknown camera model 'THIN_PRISM_FISHEYE'.*known: DIVISION"
    ):
        read_cameras(tmp_path)
    (tmp_path / "cameras.txt").unlink()
    (tmp_path / "cameras.bin").write_bytes(struct.pack("<QIiQQ", 1, 1, 11, 640, 480) + b"\0" * 128)
    with pytest.raises(UnreadableFile, match="has a camera of model 11; known: 0 SIMPLE_PINHOLE"):
        read_cameras(tmp_path)


def test_binary_usd_is_pointed_to_its_own_tool(tmp_path: Path) -> None:
    (tmp_path / "c.usd").write_bytes(b"PXR-USDC" + b"\0" * 100)
    with pytest.raises(UnreadableFile, match="is binary USD; convert it: usdcat"):
        read_cameras(tmp_path / "c.usd")


def test_what_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFile, match="no such file"):
        read_cameras(tmp_path / "none.json")
    with pytest.raises(UnreadableFile, match="a folder without a known camera file"):
        read_cameras(tmp_path)
    (tmp_path / "empty.json").write_bytes(b"")
    with pytest.raises(UnreadableFile, match="is empty"):
        read_cameras(tmp_path / "empty.json")
    with pytest.raises(UnknownName, match="did you mean 'opencv'"):
        read_cameras(tmp_path / "empty.json", format_name="openvc")
