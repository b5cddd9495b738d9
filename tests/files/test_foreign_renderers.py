"""Cameras of renderers in files written by hand, projected by the renderer's own formula: an oracle apart from us."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest

from cadcam.errors import UnreadableFile
from cadcam.files.foreign.registry import read_cameras

from .foreign_files import GL, R, T, agree, only, points, text_of


def test_blender(tmp_path: Path, rng: np.random.Generator) -> None:
    """Blender, BKE_camera_params_compute_viewplane, sensor fit horizontal: the window of the plane at distance 1."""
    world_from_eye = np.eye(4)
    world_from_eye[:3, :3], world_from_eye[:3, 3] = R.T @ GL, -R.T @ T
    W, H, lens, sensor, shift_x, shift_y, ax, ay = 640, 480, 30.0, 36.0, 0.01, -0.02, 1.0, 1.02
    text = (
        f'import bpy\nCAMERA = {{\n  "name": "c", "lens": {lens}, "sensor_width": {sensor}, "shift_x": {shift_x},\n'
        f'  "shift_y": {shift_y}, "pixel_aspect": ({ax}, {ay}), "resolution": ({W}, {H}),\n'
        f'  "matrix_world": {world_from_eye.tolist()},\n}}\nraise SystemExit("never run")\n'
    )
    ratio, pitch = ay / ax, sensor / lens / W
    left, bottom = (-W / 2 + shift_x * W) * pitch, (-H / 2 * ratio + shift_y * W) * pitch
    p = points(rng)
    eye = p @ GL
    u = (eye[:, 0] / -eye[:, 2] - left) / pitch
    v = H - (eye[:, 1] / -eye[:, 2] - bottom) / (pitch * ratio)
    agree(only(tmp_path / "f.py", text), p, u - 0.5, v - 0.5)


def test_gltf(tmp_path: Path, rng: np.random.Generator) -> None:
    """glTF 2.0: the field of view spans the picture edge to edge; a parent node moves its children."""
    yfov, aspect = 0.9, 1.3
    local = np.eye(4)
    local[:3, :3], local[:3, 3] = R.T @ GL, -R.T @ T - [1, 2, 3]
    document = {
        "asset": {"version": "2.0"},
        "cameras": [{"type": "perspective", "perspective": {"yfov": yfov, "aspectRatio": aspect, "znear": 0.1}}],
        "nodes": [{"children": [1], "translation": [1, 2, 3]}, {"camera": 0, "matrix": local.T.ravel().tolist()}],
    }
    p = points(rng)
    eye = p @ GL
    x_ndc = eye[:, 0] / -eye[:, 2] / (aspect * np.tan(yfov / 2))
    y_ndc = eye[:, 1] / -eye[:, 2] / np.tan(yfov / 2)
    u, v = (x_ndc + 1) * 320 - 0.5, (1 - y_ndc) * 240 - 0.5
    agree(only(tmp_path / "f.gltf", json.dumps(document), size=(640, 480)), p, u, v)
    (note,) = read_cameras(tmp_path / "f.gltf", size=(640, 480)).notes
    assert "with pixels that are not square; of square ones 624 x 480 px" in note
    assert not read_cameras(tmp_path / "f.gltf", size=(624, 480)).notes
    chunk = json.dumps(document).encode()
    chunk += b" " * (-len(chunk) % 4)
    glb = b"glTF" + struct.pack("<IIII", 2, 20 + len(chunk), len(chunk), 0x4E4F534A) + chunk
    agree(only(tmp_path / "f.glb", glb, size=(640, 480)), p, u, v)


@pytest.mark.parametrize(
    ("said", "a", "b"),
    [  # UsdRender, aspectRatioConformPolicy: the apertures seen, of 36 x 27.5 in a picture of 640 x 480
        ("", 27.5 * 640 / 480, 27.5),  # by default expandAperture: nothing of the aperture is lost, pixels are square
        ('uniform token aspectRatioConformPolicy = "cropAperture"', 36.0, 36.0 * 480 / 640),
        ('uniform token aspectRatioConformPolicy = "adjustApertureWidth"', 27.5 * 640 / 480, 27.5),
        ('uniform token aspectRatioConformPolicy = "adjustApertureHeight"', 36.0, 36.0 * 480 / 640),
        ('uniform token aspectRatioConformPolicy = "adjustPixelAspectRatio"', 36.0, 27.5),
        ("uniform float pixelAspectRatio = 0.9", 36.0, 36.0 * 480 / (0.9 * 640)),  # the aperture is the wider one
        (
            """uniform float pixelAspectRatio = 0.9
        uniform token aspectRatioConformPolicy = "cropAperture\"""",
            27.5 * 0.9 * 640 / 480,
            27.5,
        ),
    ],
)
def test_usd(tmp_path: Path, rng: np.random.Generator, said: str, a: float, b: float) -> None:
    """OpenUSD, GfCamera::GetFrustum: the window at distance 1 is ([-1/2, 1/2] aperture + offset) / focalLength."""
    f, da, db = 24.0, 0.3, -0.2
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = R.T @ GL, -R.T @ T - [1, 2, 3]
    rows = ", ".join(f"({text_of(row)})" for row in matrix.T)
    text = f"""#usda 1.0
(
    defaultPrim = "World"
    doc = "a text; with {{ marks"
    metersPerUnit = 1
)
def Xform "World" (
    kind = "group"
)
{{
    double3 xformOp:translate = (1, 2, 3)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Camera "cam"
    {{
        float focalLength = {f}
        float focalLength.comment
        float horizontalAperture = 36
        float verticalAperture = 27.5
        float horizontalApertureOffset = {da}
        float verticalApertureOffset = {db}
        token projection = "perspective"
        matrix4d xformOp:transform = ( {rows} )
        uniform token[] xformOpOrder = ["xformOp:transform"]
    }}
}}
def Scope "Render"
{{
    def RenderProduct "p"
    {{
        rel camera = </World/cam>
        uniform int2 resolution = (640, 480)
        {said}
    }}
}}
"""
    p = points(rng)
    eye = p @ GL
    u = (eye[:, 0] / -eye[:, 2] - (-a / 2 + da) / f) / (a / f) * 640
    v = 480 - (eye[:, 1] / -eye[:, 2] - (-b / 2 + db) / f) / (b / f) * 480
    agree(only(tmp_path / "f.usda", text), p, u - 0.5, v - 0.5)


def test_usd_without_a_render_product_has_square_pixels(tmp_path: Path) -> None:
    """What views expand the camera's aperture by default; a policy that is not known is refused."""
    text = '#usda 1.0\ndef Camera "c"\n{\n    float focalLength = 24\n}\n'
    (tmp_path / "f.usda").write_text(text)
    camera = read_cameras(tmp_path / "f.usda", size=(1920, 1080)).cameras[0].camera
    assert camera.fx == pytest.approx(24 * 1080 / 15.2908, rel=1e-12)
    assert camera.fy == pytest.approx(camera.fx, rel=1e-12)
    product = 'def RenderProduct "p"\n{\n    rel camera = </c>\n    uniform int2 resolution = (1920, 1080)\n'
    (tmp_path / "g.usda").write_text(text + product + '    uniform token aspectRatioConformPolicy = "squeeze"\n}\n')
    with pytest.raises(UnreadableFile, match="aspectRatioConformPolicy 'squeeze'; known: expandAperture"):
        read_cameras(tmp_path / "g.usda")


def test_usd_operations_as_programs_write_them(tmp_path: Path) -> None:
    """Blender and Omniverse write a scale of 1, Maya a pivot that is undone: the last of the order acts first."""
    text = """#usda 1.0
def Camera "c"
{
    double3 xformOp:translate = (10, 20, 30)
    double3 xformOp:translate:pivot = (1, 2, 3)
    float xformOp:rotateZ = 90
    float3 xformOp:scale = (1, 1.0000001, 1)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:translate:pivot", "xformOp:rotateZ", "xformOp:scale",
        "!invert!xformOp:translate:pivot"]
}
"""
    (tmp_path / "f.usda").write_text(text)
    pose = read_cameras(tmp_path / "f.usda", size=(640, 480)).cameras[0].camera_from_world
    assert pose is not None
    turned = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]) @ [-1, -2, -3]  # about the pivot (1, 2, 3), then moved
    assert pose.origin == pytest.approx(10 * (turned + np.array([11, 22, 33])), abs=1e-9)
    (tmp_path / "g.usda").write_text(text.replace("1.0000001", "2"))
    with pytest.raises(UnreadableFile, match="scale is not 1"):
        read_cameras(tmp_path / "g.usda", size=(640, 480))
