"""HALCON camera parameters (.dat) and, beside them, a pose (NAME.pose.dat).

Focus, Sx, Sy in metres, Cx, Cy in px with (0, 0) the centre of the top-left pixel. Distortion takes the measured
point (u, v) of the sensor plane, in metres, to the ideal one: the division model u/(1 + Kappa r^2), or the polynomial
u + u (K1 r^2 + K2 r^4 + K3 r^6) + P1 (r^2 + 2 u^2) + 2 P2 u v, and v + v (...) + 2 P1 u v + P2 (r^2 + 2 v^2), with
Poly1..5 = K1 K2 K3 P1 P2. In our terms k = Kappa f^2; k1 = K1 f^2, k2 = K2 f^4, k3 = K3 f^6, p1 = P2 f, p2 = P1 f of
the inverse Brown-Conrady lens. A pose is translation in m, three angles in degrees (or a Rodriguez vector) and a code
for their order. Source: HALCON reference, `read_cam_par`, `calibrate_cameras`, `create_pose`, `read_pose`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.camera import Camera
from cadcam.camera.lens import Division, Ideal, InverseBrownConrady, Lens
from cadcam.errors import UnreadableFile
from cadcam.files.foreign.model import Files, Foreign, Format, Holds, NamedCamera, WriteOptions
from cadcam.files.foreign.pose import numbers
from cadcam.files.foreign.source import ForeignFile
from cadcam.files.text import TextFile, number_in
from cadcam.geometry.rigid import Rigid

_MM = 1000.0
_PIXEL_MM = 0.005  # the pitch written where none is known: no pixel depends on it
_ENTRY = re.compile(r"^[ \t]*(\w+)[ \t]*:[ \t]*\w*[ \t]*:\s*([^;]*);", re.MULTILINE)
_DIVISION = ("Focus", "Kappa", "Sx", "Sy", "Cx", "Cy", "ImageWidth", "ImageHeight")
_POLY = ("Poly1", "Poly2", "Poly3", "Poly4", "Poly5")
_POLYNOMIAL = ("Focus", *_POLY, *_DIVISION[2:])
_POWERS = np.array([2, 4, 6, 1, 1])  # of the focal length, from Poly1..5 to k1 k2 k3 p2 p1


def recognises(source: ForeignFile) -> bool:
    """Return whether this is a HALCON parameter group of a camera."""
    return bool(re.search(r"^[ \t]*ParGroup\s*:\s*\w*Camera\s*:\s*Parameter", source.head(), re.MULTILINE))


def read(source: ForeignFile) -> Foreign:
    """Return the camera, with the pose in NAME.pose.dat where there is one."""
    file = source.text()
    values = _values(file)
    for names in (_DIVISION, _POLYNOMIAL):
        if set(names) == set(values):
            break
    else:
        raise UnreadableFile(
            file.path,
            f"has the parameters {', '.join(values) or 'none'}",
            "read here: area scan cameras, division and polynomial, without tilt, telecentric or line scan",
        )
    f, sx, sy = values["Focus"], values["Sx"], values["Sy"]
    if not (f > 0 and sx > 0 and sy > 0):
        raise UnreadableFile(
            file.path, f"has Focus {f:g}, Sx {sx:g}, Sy {sy:g}", "positive lengths in m; not telecentric"
        )
    K = np.array([[f / sx, 0, values["Cx"]], [0, f / sy, values["Cy"]], [0, 0, 1]])
    size = values["ImageWidth"], values["ImageHeight"]
    camera = Camera(size, K, _lens(values, f))  # type: ignore[arg-type]  # Camera refuses sizes that are not whole
    beside = _pose_name(source.path)
    pose = _pose(source.text(beside)) if source.has(beside) else None
    return Foreign(
        "halcon",
        (NamedCamera("camera", camera, pose),),
        (f"pixel pitch {sy * 1e6:.4g} um, focal length {f * _MM:.6g} mm",),
    )


def write(cameras: Sequence[NamedCamera], target: WriteOptions) -> Files:
    """Write one camera, and beside it its pose; the pixel pitch is that given, else 5 um (no pixel depends on it)."""
    named = cameras[0]
    camera, lens = named.camera, named.camera.lens
    sy = (target.pixel_mm or _PIXEL_MM) / _MM
    f = camera.fy * sy
    values: dict[str, float] = {"Focus": f, "Sx": f / camera.fx, "Sy": sy}
    values |= {"Cx": camera.K[0, 2], "Cy": camera.K[1, 2], "ImageWidth": camera.width, "ImageHeight": camera.height}
    if isinstance(lens, InverseBrownConrady):
        terms = np.array([lens.k1, lens.k2, lens.k3, lens.p2, lens.p1]) / f**_POWERS
        values |= dict(zip(_POLY, terms.tolist(), strict=True))
    else:
        values["Kappa"] = lens.k / f**2 if isinstance(lens, Division) else 0.0
    names = _POLYNOMIAL if isinstance(lens, InverseBrownConrady) else _DIVISION
    lines = ["# INTERNAL CAMERA PARAMETERS", "", "ParGroup: Camera: Parameter;", '  "Internal camera parameters";', ""]
    for name in names:
        short, kind, text = _ABOUT[name]
        value = repr(int(values[name])) if kind.startswith("INT") else repr(float(values[name]))
        lines += [f"{name}:{short}: {value};", f"  {kind};", f'  "{text}";', ""]
    files = {"": "\n".join(lines).encode()}
    if named.camera_from_world is not None:
        files[_pose_name(target.name)] = _pose_text(named.camera_from_world).encode()
    return files


_ABOUT = {
    "Focus": ("foc", "DOUBLE:0.0:", "Focal length of the lens [meter]"),
    "Kappa": ("kappa", "DOUBLE::", "Radial distortion coefficient [1/(meter*meter)]"),
    **{name: (name.lower(), "DOUBLE::", f"Polynomial distortion coefficient {name[4:]}") for name in _POLY},
    "Sx": ("sx", "DOUBLE:0.0:", "Width of a cell on the sensor [meter]"),
    "Sy": ("sy", "DOUBLE:0.0:", "Height of a cell on the sensor [meter]"),
    "Cx": ("cx", "DOUBLE::", "X-coordinate of the image center [pixel]"),
    "Cy": ("cy", "DOUBLE::", "Y-coordinate of the image center [pixel]"),
    "ImageWidth": ("imgw", "INT:1:32767", "Width of the images [pixel]"),
    "ImageHeight": ("imgh", "INT:1:32767", "Height of the images [pixel]"),
}


def _values(file: TextFile) -> dict[str, float]:
    """Return the parameters by name; the group's own line is not one."""
    out: dict[str, float] = {}
    for entry in _ENTRY.finditer(re.sub(r"^[ \t]*#.*$", "", file.text, flags=re.MULTILINE)):
        name, text = entry[1], entry[2].strip()
        if name in ("ParGroup", "DOUBLE", "INT"):
            continue
        if name in out:
            raise UnreadableFile(file.path, f"has {name} twice", "leave one of them")
        out[name] = number_in(file, file.text[: entry.start()].count("\n") + 1, name, text)
    return out


def _lens(values: dict[str, float], f: float) -> Lens:
    if "Kappa" in values:
        return Division(values["Kappa"] * f**2) if values["Kappa"] else Ideal()
    k1, k2, k3, p2, p1 = (np.array([values[name] for name in _POLY]) * f**_POWERS).tolist()
    return InverseBrownConrady(k1, k2, p1, p2, k3) if any((k1, k2, k3, p1, p2)) else Ideal()


def _pose_name(path: str) -> str:
    return f"{Path(path).stem}.pose.dat"


def _pose(file: TextFile) -> Rigid:
    found: dict[str, Array] = {}
    for at, line in enumerate(file.text.splitlines(), start=1):
        words = line.split()
        if words and words[0] in ("f", "r", "t"):
            found[words[0]] = np.array([number_in(file, at, words[0], word) for word in words[1:]])
    if set(found) != {"f", "r", "t"} or found["f"].size != 1 or found["r"].size != 3 or found["t"].size != 3:
        raise UnreadableFile(
            file.path, "is no HALCON pose", "a line f CODE, a line r with 3 and a line t with 3 numbers"
        )
    code = float(found["f"][0])
    if code not in _ROTATIONS:
        raise UnreadableFile(
            file.path,
            f"has the representation type {code:g}",
            "read here: 0 (gba), 2 (abg), 4 (rodriguez); convert_pose_type helps",
        )
    return Rigid(_ROTATIONS[code](found["r"]), found["t"] * _MM)


def _gba(degrees: Array) -> Array:
    """Return Rx(alpha) Ry(beta) Rz(gamma)."""
    (sa, sb, sc), (ca, cb, cc) = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    Rx = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
    Ry = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    Rz = np.array([[cc, -sc, 0], [sc, cc, 0], [0, 0, 1]])
    return np.asarray(Rx @ Ry @ Rz)


def _abg(degrees: Array) -> Array:
    """Return Rz(gamma) Ry(beta) Rx(alpha)."""
    return _gba(-degrees).T


def _rodriguez(vector: Array) -> Array:
    """Return the rotation about `vector` whose length is the tangent of half the angle (Cayley)."""
    x, y, z = vector
    S = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + 2 / (1 + vector @ vector) * (S + S @ S))


_ROTATIONS = {0.0: _gba, 2.0: _abg, 4.0: _rodriguez}


def _pose_text(camera_from_world: Rigid) -> str:
    R = camera_from_world.rotation
    beta = np.arctan2(R[0, 2], np.hypot(R[0, 0], R[0, 1]))
    if np.hypot(R[0, 0], R[0, 1]) < 1e-9:  # gimbal lock: only alpha +- gamma is defined
        alpha, gamma = np.arctan2(R[1, 0], R[1, 1]), 0.0
        alpha = alpha if beta > 0 else -alpha
    else:
        alpha, gamma = np.arctan2(-R[1, 2], R[2, 2]), np.arctan2(-R[0, 1], R[0, 0])
    angles, t = np.degrees([alpha, beta, gamma]), camera_from_world.translation / _MM
    return (
        "# 3D POSE PARAMETERS: rotation and translation\n\n# Used representation type:\nf 0\n\n"
        f"# Rotation angles [deg] or Rodriguez vector:\nr {' '.join(map(repr, numbers(angles)))}\n\n"
        f"# Translation vector (x y z [m]):\nt {' '.join(map(repr, numbers(t)))}\n"
    )


FORMAT = Format(
    name="halcon",
    title="HALCON cam_par",
    suffixes=(".dat", ".cal"),
    holds=Holds(
        {"ideal": (), "division": ("k",), "inverse-brown-conrady": tuple(InverseBrownConrady().parameters)}, pose="yes"
    ),
    recognises=recognises,
    read=read,
    write=write,
    unit="m",
)
