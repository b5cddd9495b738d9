"""Files written by hand, projected by the formula that the format's own documents give: an oracle apart from us."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest

from cadcam.camera.lens import ExtendedUnified
from cadcam.errors import UnreadableFile
from cadcam.files.foreign.registry import read_cameras
from cadcam.geometry import rotation as so3

from .foreign_files import GL, R, T, agree, brown, only, points, text_of


def test_opencv(tmp_path: Path, rng: np.random.Generator) -> None:
    w, p = so3.log(R), points(rng)
    text = f"""%YAML:1.0
---
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 500., 0., 321., 0., 505., 243., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -0.2, 0.05, 1e-3, -2e-3, 0.01 ]
extrinsic_parameters: !!opencv-matrix
   rows: 1
   cols: 6
   dt: d
   data: [ {text_of(np.concatenate([w, T]))} ]
"""
    x, y = brown(p, -0.2, 0.05, 1e-3, -2e-3, 0.01)
    agree(only(tmp_path / "f", text, unit="m"), p, 500 * x + 321, 505 * y + 243)


def test_opencv_json_and_named_stereo_pair(tmp_path: Path) -> None:
    def matrix(rows: int, columns: int, data: list[float]) -> dict[str, object]:
        return {"type_id": "opencv-matrix", "rows": rows, "cols": columns, "dt": "d", "data": data}

    values = {
        "M1": matrix(3, 3, [500, 0, 320, 0, 500, 240, 0, 0, 1]),
        "D1": matrix(1, 4, [0.1, 0, 0, 0]),
        "M2": matrix(3, 3, [510, 0, 325, 0, 510, 245, 0, 0, 1]),
        "D2": matrix(1, 4, [0, 0, 0, 0]),
    }
    (tmp_path / "stereo.json").write_text(json.dumps(values))
    found = read_cameras(tmp_path / "stereo.json", format_name="opencv", size=(640, 480))
    assert [named.name for named in found.cameras] == ["M1", "M2"]
    assert found.cameras[0].camera.lens.parameters["k1"] == 0.1
    assert found.cameras[1].camera.fx == 510


def test_ros_and_a_printed_message(tmp_path: Path, rng: np.random.Generator) -> None:
    p = points(rng)
    x, y = brown(p, -0.2, 0.05, 1e-3, -2e-3, 0.01)
    text = """image_width: 640
image_height: 480
camera_name: head
camera_matrix:
  rows: 3
  cols: 3
  data: [500, 0, 321, 0, 505, 243, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.2, 0.05, 0.001, -0.002, 0.01]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [490, 0, 320, -50, 0, 490, 240, 0, 0, 0, 1, 0]
"""
    named = only(tmp_path / "f", text)
    assert named.name == "head"
    agree(named, p, 500 * x + 321, 505 * y + 243, posed=False)
    assert "projection matrix is not kept" in read_cameras(tmp_path / "f").notes[0]
    message = """height: 480
width: 640
distortion_model: plumb_bob
d: [-0.2, 0.05, 0.001, -0.002, 0.01]
k: [500.0, 0.0, 321.0, 0.0, 505.0, 243.0, 0.0, 0.0, 1.0]
"""
    agree(only(tmp_path / "m", message), p, 500 * x + 321, 505 * y + 243, posed=False)


@pytest.mark.parametrize(
    ("more", "said"),
    [  # CameraInfo.msg: zeros are the whole picture, unbinned; a region is in px of the unbinned whole
        ("binning_x: 0\nbinning_y: 0\nroi:\n  x_offset: 0\n  y_offset: 0\n  height: 0\n  width: 0\n", ""),
        ("binning_x: 1\nbinning_y: 1\nroi:\n  x_offset: 0\n  y_offset: 0\n  height: 480\n  width: 640\n", ""),
        ("binning_x: 2\nbinning_y: 2\n", "with --binning 2x2"),
        (
            "binning_x: 2\nbinning_y: 1\nroi:\n  x_offset: 40\n  y_offset: 20\n  height: 400\n  width: 500\n",
            "with --crop 40,20,500x400, then with --binning 2x1",
        ),
    ],
)
def test_a_ros_message_of_a_binned_or_cut_picture_says_so(tmp_path: Path, more: str, said: str) -> None:
    """Size and K are the calibration's; image_geometry, too, derives the picture's own from them."""
    text = "height: 480\nwidth: 640\ndistortion_model: plumb_bob\nd: [0.0, 0.0, 0.0, 0.0, 0.0]\n"
    (tmp_path / "m").write_text(f"{text}k: [500.0, 0.0, 321.0, 0.0, 505.0, 243.0, 0.0, 0.0, 1.0]\n{more}")
    found = read_cameras(tmp_path / "m")
    assert found.cameras[0].camera.size == (640, 480)
    assert " ".join(found.notes).endswith(said)
    assert bool(said) == any("own picture" in note for note in found.notes)


def test_colmap_counts_pixels_from_the_corner(tmp_path: Path, rng: np.random.Generator) -> None:
    (tmp_path / "cameras.txt").write_text("# a comment\n7 OPENCV 640 480 500 505 321.5 243.5 -0.2 0.05 0.001 -0.002\n")
    q = so3.quaternion(R)
    (tmp_path / "images.txt").write_text(
        f"1 {' '.join(map(repr, (*q.tolist(), *T.tolist())))} 7 a name.jpg\n10 20 -1\n"
    )
    found = read_cameras(tmp_path, unit="m")
    assert found.format == "colmap"
    assert found.cameras[0].name == "a name.jpg"
    p = points(rng)
    x, y = brown(p, -0.2, 0.05, 1e-3, -2e-3)
    agree(found.cameras[0], p, 500 * x + 321.5 - 0.5, 505 * y + 243.5 - 0.5)


def test_colmap_binary_is_little_endian_with_points_to_skip(tmp_path: Path, rng: np.random.Generator) -> None:
    camera = struct.pack("<QIiQQ", 1, 7, 2, 640, 480) + struct.pack("<4d", 500, 320, 240, -0.1)  # SIMPLE_RADIAL
    image = struct.pack("<QI7dI", 1, 3, *so3.quaternion(R), *T, 7) + b"left.png\0"
    image += struct.pack("<QddqddqQ"[:2], 2) + struct.pack("<ddqddq", 1, 2, -1, 3, 4, 5)
    (tmp_path / "cameras.bin").write_bytes(camera)
    (tmp_path / "images.bin").write_bytes(image)
    found = read_cameras(tmp_path, unit="m")
    assert found.format == "colmap-bin"
    p = points(rng)
    x, y = brown(p, -0.1, 0, 0, 0)
    agree(found.cameras[0], p, 500 * x + 320 - 0.5, 500 * y + 240 - 0.5)


def test_kalibr_chain(tmp_path: Path, rng: np.random.Generator) -> None:
    """omni: Mei and Rives 2007, u = x/(z + xi |p|); ds: Usenko 2018, EQ 40."""
    M = np.eye(4)
    M[:3, :3], M[:3, 3] = R, T
    rows = "\n".join(f"  - [{text_of(row)}]" for row in M)
    text = f"""cam0:
  camera_model: omni
  intrinsics: [0.8, 700.0, 705.0, 321.0, 243.0]
  distortion_model: none
  distortion_coeffs: []
  resolution: [640, 480]
cam1:
  camera_model: ds
  intrinsics: [-0.2, 0.6, 300.0, 305.0, 322.0, 244.0]
  distortion_model: none
  distortion_coeffs: []
  resolution: [640, 480]
  T_cn_cnm1:
{rows}
"""
    (tmp_path / "chain.yaml").write_text(text)
    omni, sphere = read_cameras(tmp_path / "chain.yaml").cameras
    p = points(rng)
    d = np.linalg.norm(p, axis=1)
    agree(omni, p, 700 * p[:, 0] / (p[:, 2] + 0.8 * d) + 321, 705 * p[:, 1] / (p[:, 2] + 0.8 * d) + 243, posed=False)
    shifted = -0.2 * d + p[:, 2]
    below = 0.6 * np.sqrt(p[:, 0] ** 2 + p[:, 1] ** 2 + shifted**2) + 0.4 * shifted
    agree(sphere, p, 300 * p[:, 0] / below + 322, 305 * p[:, 1] / below + 244)


def test_kalibr_cameras_are_chained_by_number_though_its_writer_sorts_them_as_text(tmp_path: Path) -> None:
    """PyYAML, by which Kalibr writes, puts cam10 before cam2; T_cn_cnm1 is always from the camera one number lower."""

    def camera(n: int, number: int) -> str:
        step = f"\n  T_cn_cnm1: [[1, 0, 0, {number}], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]" if n else ""
        return f"""cam{n}:
  camera_model: pinhole
  intrinsics: [700.0, 705.0, 321.0, 243.0]
  distortion_model: none
  distortion_coeffs: []
  resolution: [640, 480]{step}
"""

    names = sorted(range(12), key=str)
    assert names[:3] == [0, 1, 10]
    (tmp_path / "chain.yaml").write_text("".join(camera(n, n) for n in names))
    found = read_cameras(tmp_path / "chain.yaml").cameras
    assert [named.name for named in found] == [f"cam{n}" for n in range(12)]
    places = [named.camera_from_world.translation[0] for named in found if named.camera_from_world is not None]
    assert places == [1000.0 * sum(range(n + 1)) for n in range(12)]
    (tmp_path / "gap.yaml").write_text(camera(0, 0) + camera(2, 2))
    with pytest.raises(UnreadableFile, match="has no cam1"):
        read_cameras(tmp_path / "gap.yaml")


def test_mrcal_and_its_stereographic_lens(tmp_path: Path, rng: np.random.Generator) -> None:
    rt = text_of(np.concatenate([so3.log(R), T]))
    text = f"""{{
    'lensmodel':  'LENSMODEL_OPENCV5',
    # a comment
    'intrinsics': [ 500., 505., 321., 243., -0.2, 0.05, 1e-3, -2e-3, 0.01,],
    'extrinsics': [ {rt},],
    'imagersize': [ 640, 480,],
    'optimization_inputs': b'abc',
}}
"""
    p = points(rng)
    x, y = brown(p, -0.2, 0.05, 1e-3, -2e-3, 0.01)
    agree(only(tmp_path / "f", text, unit="m"), p, 500 * x + 321, 505 * y + 243)
    assert "optimization_inputs" in read_cameras(tmp_path / "f", unit="m").notes[0]
    wide = text.replace("OPENCV5", "STEREOGRAPHIC").replace(", -0.2, 0.05, 1e-3, -2e-3, 0.01", "")
    t, r = np.arctan2(np.hypot(p[:, 0], p[:, 1]), p[:, 2]), np.hypot(p[:, 0], p[:, 1])
    scale = 2 * np.tan(t / 2) / r  # mrcal doc/lensmodels.org
    named = only(tmp_path / "g", wide, unit="m")
    assert named.camera.lens == ExtendedUnified(0.5, 1.0)
    agree(named, p, 500 * p[:, 0] * scale + 321, 505 * p[:, 1] * scale + 243)


def test_bop(tmp_path: Path, rng: np.random.Generator) -> None:
    K = np.array([[500, 1.5, 321], [0, 505, 243], [0, 0, 1]])
    one = {"cx": 321, "cy": 243, "depth_scale": 0.1, "fx": 500, "fy": 505, "height": 480, "width": 640}
    scene = {"3": {"cam_K": K.ravel().tolist(), "cam_R_w2c": R.ravel().tolist(), "cam_t_w2c": (1000 * T).tolist()}}
    (tmp_path / "camera.json").write_text(json.dumps(one))
    (tmp_path / "scene_camera.json").write_text(json.dumps(scene))
    p = points(rng)
    q = (p / p[:, 2:]) @ K.T
    for path in (tmp_path, tmp_path / "scene_camera.json"):
        named = read_cameras(path).cameras[0]
        assert named.name == "3"
        agree(named, p, q[:, 0], q[:, 1])


def test_nerfstudio_looks_along_minus_z_and_counts_from_the_corner(tmp_path: Path, rng: np.random.Generator) -> None:
    world_from_eye = np.eye(4)
    world_from_eye[:3, :3], world_from_eye[:3, 3] = R.T @ GL, -R.T @ T
    values = {"camera_model": "OPENCV", "fl_x": 500, "fl_y": 505, "cx": 321.5, "cy": 243.5, "w": 640, "h": 480}
    terms = {"k1": -0.2, "k2": 0.05, "p1": 1e-3, "p2": -2e-3}
    frame = {"file_path": "images/a.png", "transform_matrix": world_from_eye.tolist()}
    p = points(rng)
    x, y = brown(p, **terms)
    text = json.dumps({**values, **terms, "frames": [frame]})
    agree(only(tmp_path / "f", text, unit="m"), p, 500 * x + 321, 505 * y + 243)
    old = json.dumps({"camera_angle_x": 2 * np.arctan(640 / 2 / 500), "frames": [frame]})
    named = only(tmp_path / "g", old, unit="m", size=(640, 480))
    agree(named, p, 500 * p[:, 0] / p[:, 2] + 319.5, 500 * p[:, 1] / p[:, 2] + 239.5)


def test_instant_ngp_tells_a_fisheye_by_a_flag(tmp_path: Path, rng: np.random.Generator) -> None:
    """instant-ngp, scripts/colmap2nerf.py: no camera_model, k1 to k4 of both lenses, sizes as floats."""
    world_from_eye = np.eye(4)
    world_from_eye[:3, :3], world_from_eye[:3, 3] = R.T @ GL, -R.T @ T
    terms = {"k1": 0.03, "k2": -0.01, "k3": 0.002, "k4": 0.001, "p1": 0, "p2": 0, "is_fisheye": True}
    values = {
        "camera_angle_x": 1.1,
        "fl_x": 500,
        "fl_y": 505,
        "cx": 321.5,
        "cy": 243.5,
        "w": 640.0,
        "h": 480.0,
        **terms,
    }
    frame = {"file_path": "images/a.png", "sharpness": 30.0, "transform_matrix": world_from_eye.tolist()}
    p = points(rng)
    r = np.hypot(p[:, 0], p[:, 1])
    t = np.arctan2(r, p[:, 2])
    scale = t * (1 + 0.03 * t**2 - 0.01 * t**4 + 0.002 * t**6 + 0.001 * t**8) / r
    named = only(tmp_path / "f", json.dumps({**values, "aabb_scale": 16, "frames": [frame]}), unit="m")
    agree(named, p, 500 * p[:, 0] * scale + 321, 505 * p[:, 1] * scale + 243)
    (tmp_path / "g").write_text(json.dumps({**values, "camera_model": "OPENCV", "frames": [frame]}))
    with pytest.raises(UnreadableFile, match="camera_model 'OPENCV' and is_fisheye"):
        read_cameras(tmp_path / "g", unit="m")


def test_metashape_swaps_the_tangential_terms_and_counts_from_the_middle(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    """Metashape manual, camera models: x' = x(...) + P1(r^2 + 2x^2) + 2 P2 xy, u = w/2 + cx + x'f + x'B1 + y'B2."""
    chunk_from_camera = np.eye(4)
    chunk_R, chunk_t, s = so3.exp([0.1, 0.2, 0.3]), np.array([5.0, 6, 7]), 2.5
    world_from_camera_R, world_from_camera_t = R.T, -R.T @ T
    chunk_from_camera[:3, :3] = chunk_R.T @ world_from_camera_R
    chunk_from_camera[:3, 3] = chunk_R.T @ (world_from_camera_t - chunk_t) / s
    text = f"""<?xml version="1.0" encoding="UTF-8"?>
<document version="2.0.0"><chunk label="Chunk 1" enabled="true">
<sensors next_id="1"><sensor id="0" label="cam" type="frame"><resolution width="640" height="480"/>
<calibration type="frame" class="initial"><resolution width="640" height="480"/><f>1</f></calibration>
<calibration type="frame" class="adjusted"><resolution width="640" height="480"/>
<f>505</f><cx>1.5</cx><cy>3.25</cy><b1>-5</b1><b2>0.7</b2>
<k1>-0.2</k1><k2>0.05</k2><k3>0.01</k3><p1>0.001</p1><p2>-0.002</p2>
</calibration></sensor></sensors>
<cameras next_id="2" next_group_id="1"><camera id="0" sensor_id="0" label="not aligned"/>
<group id="0"><camera id="1" sensor_id="0" label="a">
<transform>{text_of(chunk_from_camera).replace(",", "")}</transform></camera></group>
</cameras>
<transform><rotation>{text_of(chunk_R).replace(",", "")}</rotation>
<translation>5 6 7</translation><scale>2.5</scale></transform>
</chunk></document>
"""
    p = points(rng)
    x, y = p[:, 0] / p[:, 2], p[:, 1] / p[:, 2]
    r2 = x * x + y * y
    g = 1 - 0.2 * r2 + 0.05 * r2**2 + 0.01 * r2**3
    xd = x * g + 0.001 * (r2 + 2 * x * x) + 2 * -0.002 * x * y
    yd = y * g + -0.002 * (r2 + 2 * y * y) + 2 * 0.001 * x * y
    u, v = 320 + 1.5 + xd * 505 + xd * -5 + yd * 0.7, 240 + 3.25 + yd * 505
    agree(only(tmp_path / "f.xml", text, unit="m"), p, u - 0.5, v - 0.5)
    assert "1 cameras are not aligned" in read_cameras(tmp_path / "f.xml", unit="m").notes[0]


def halcon_text(terms: str) -> str:
    entry = '{}:x: {};\n  DOUBLE::;\n  "text: with; marks";\n'
    values = {"Sx": 7.4e-6, "Sy": 7.5e-6, "Cx": 321.0, "Cy": 243.0, "ImageWidth": 640, "ImageHeight": 480}
    return '# INTERNAL CAMERA PARAMETERS\nParGroup: Camera: Parameter;\n"Internal camera parameters";\n' + "".join(
        entry.format(*line) for line in [("Focus", 0.004), *(t.split("=") for t in terms.split()), *values.items()]
    )


@pytest.mark.parametrize("model", ["division", "polynomial"])
def test_halcon_undistorts_from_the_picture(tmp_path: Path, rng: np.random.Generator, model: str) -> None:
    """HALCON reference, calibrate_cameras: from the distorted point of the sensor, in metres, to the ideal one."""
    K1, K2, K3, P1, P2 = 5067.98, 8.9e6, -6e10, -0.128, 0.13
    terms = "Kappa=-2253.5" if model == "division" else f"Poly1={K1} Poly2={K2} Poly3={K3} Poly4={P1} Poly5={P2}"
    (tmp_path / "cam.pose.dat").write_text(
        "# 3D POSE PARAMETERS: rotation and translation\n\nf 4\nr "
        + text_of(so3.log(R) / np.linalg.norm(so3.log(R)) * np.tan(np.linalg.norm(so3.log(R)) / 2)).replace(",", "")
        + f"\nt {text_of(T).replace(',', '')}\n"
    )
    named = only(tmp_path / "cam.dat", halcon_text(terms))
    column, row = rng.uniform(0, 639, 60), rng.uniform(0, 479, 60)
    ut, vt = (column - 321) * 7.4e-6, (row - 243) * 7.5e-6
    r2 = ut * ut + vt * vt
    if model == "division":
        u, v = ut / (1 - 2253.5 * r2), vt / (1 - 2253.5 * r2)
    else:
        g = K1 * r2 + K2 * r2**2 + K3 * r2**3
        u = ut + ut * g + P1 * (r2 + 2 * ut * ut) + 2 * P2 * ut * vt
        v = vt + vt * g + 2 * P1 * ut * vt + P2 * (r2 + 2 * vt * vt)
    p = np.stack([u / 0.004, v / 0.004, np.ones(60)], axis=-1)
    agree(named, p, column, row)


def test_halcon_pose_angles(tmp_path: Path) -> None:
    """create_pose: 'gba' (0) is Rx(a) Ry(b) Rz(g), 'abg' (2) Rz(g) Ry(b) Rx(a)."""
    angles = np.radians([10.0, -20.0, 30.0])
    Rx, Ry, Rz = (so3.exp(angle * axis) for angle, axis in zip(angles, np.eye(3), strict=True))
    (tmp_path / "cam.dat").write_text(halcon_text("Kappa=0"))
    for code, rotation in ((0, Rx @ Ry @ Rz), (2, Rz @ Ry @ Rx)):
        (tmp_path / "cam.pose.dat").write_text(f"f {code}\nr 10 -20 30\nt 0 0 1\n")
        pose = read_cameras(tmp_path / "cam.dat").cameras[0].camera_from_world
        assert pose is not None
        assert np.abs(pose.rotation - rotation).max() < 1e-12
        assert pose.translation[2] == 1000


def test_visp(tmp_path: Path, rng: np.random.Generator) -> None:
    p = points(rng)
    body = "<px>500</px><py>505</py><u0>321</u0><v0>243</v0>"
    head = "<root><camera><name>c</name><image_width>640</image_width><image_height>480</image_height><model>"
    text = (
        f"{head}<type>perspectiveProjWithDistortion</type>{body}<kud>-0.2</kud><kdu>0.21</kdu></model></camera></root>"
    )
    x, y = brown(p, -0.2, 0, 0, 0)
    agree(only(tmp_path / "f", text), p, 500 * x + 321, 505 * y + 243, posed=False)
    assert "ViSP's own inverse with kdu is off by up to" in read_cameras(tmp_path / "f").notes[0]
    fish = text.replace("perspectiveProjWithDistortion", "ProjWithKannalaBrandtDistortion")
    fish = fish.replace(
        "<kud>-0.2</kud><kdu>0.21</kdu>", "<k1>0.03</k1><k2>-0.01</k2><k3>0.002</k3><k4>0.001</k4><k5>0</k5>"
    )
    r = np.hypot(p[:, 0], p[:, 1])
    t = np.arctan2(r, p[:, 2])
    scale = t * (1 + 0.03 * t**2 - 0.01 * t**4 + 0.002 * t**6 + 0.001 * t**8) / r
    agree(only(tmp_path / "g", fish), p, 500 * p[:, 0] * scale + 321, 505 * p[:, 1] * scale + 243, posed=False)
