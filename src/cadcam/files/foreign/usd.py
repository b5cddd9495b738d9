"""USD cameras (UsdGeomCamera) in USD's text form, .usda.

focalLength, apertures and their offsets in tenths of a scene unit; metersPerUnit on the stage. With the window of
GfCamera, [-A/2 + offset, A/2 + offset], and the picture spanning it edge to edge: fx = focalLength W/A,
cx + 1/2 = W/2 - W offset/A, and in y, which points up, cy + 1/2 = H/2 + H offset/A with the vertical pair. A prim
looks along -z with y up; matrices are for row vectors. The picture's size is that of a RenderProduct whose camera this
is. Where its sides are in another ratio than the apertures, the product's aspectRatioConformPolicy says what gives way:
by default (expandAperture) the shorter aperture grows, and pixels stay as wide as pixelAspectRatio says; what we write
has adjustPixelAspectRatio. USD stores all these as floats: text keeps all digits, USD itself rounds them to 24 bits.
Source: OpenUSD `pxr/usd/usdGeom/camera.h`, `pxr/base/gf/camera.cpp`, `pxr/usd/usdRender/schema.usda` and `spec.cpp`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.camera import Camera
from cadcam.camera.difference import largest_difference
from cadcam.errors import UnreadableFile
from cadcam.files.foreign.model import ConversionLoss, Files, Foreign, Format, Holds, NamedCamera, WriteOptions
from cadcam.files.foreign.pose import camera_from_world_of_eye, numbers, world_from_eye
from cadcam.files.foreign.source import ForeignFile
from cadcam.files.foreign.usdtext import Prim, parsed_usda
from cadcam.files.jsontext import Place
from cadcam.geometry import rotation as so3

_UNIT_MM = 10.0  # a scene unit of 1 cm, USD's default: focal lengths are then in mm
_APERTURE_MM = 36.0  # written where no pixel pitch is known: no pixel depends on it
_KEEPS = "adjustPixelAspectRatio"  # the policy that leaves both apertures as they are
_INVERT = "!invert!"
_FLOAT = 1e-6  # of a scale of 1 in USD's floats
_POLICIES = ("expandAperture", "cropAperture", "adjustApertureWidth", "adjustApertureHeight", _KEEPS)


def recognises(source: ForeignFile) -> bool:
    """Return whether this is USD, in its text form or another."""
    if source.is_folder:
        return False
    return source.data()[:8] == b"PXR-USDC" or source.head().lstrip().startswith("#usda")


def read(source: ForeignFile) -> Foreign:
    """Return the cameras with their poses, the sizes from render products."""
    if source.data()[:8] == b"PXR-USDC":
        raise UnreadableFile(source.path, "is binary USD", "convert it: usdcat file.usd -o file.usda")
    root = parsed_usda(source.text())
    stage = Place(source.path, (), root.attributes)
    mm = 1000 * (stage.at("metersPerUnit").number() if "metersPerUnit" in root.attributes else 0.01)
    products = _products(root, source.path)
    cameras = []
    for path, matrix, prim in _cameras(root, "", np.eye(4), source.path):
        place = Place(source.path, tuple(path.strip("/").split("/")), prim.attributes)
        product = products.get(path) or _Product(source.needed_size(f"camera {path}"))
        pose = camera_from_world_of_eye(matrix.T, mm, place.error)
        cameras.append(NamedCamera(prim.name, place.build(partial(_camera, place, product)), pose))
    if not cameras:
        raise UnreadableFile(source.path, "holds no camera", "export it with its cameras")
    return Foreign("usd", tuple(cameras))


def write(cameras: Sequence[NamedCamera], target: WriteOptions) -> Files:
    """Write a stage of centimetres with a camera and a render product each."""
    names = _identifiers(cameras)
    lines = ["#usda 1.0", "(", f"    metersPerUnit = {_UNIT_MM / 1000!r}", '    upAxis = "Z"', ")", ""]
    for name, named in zip(names, cameras, strict=True):
        values = _values(named.camera, named.camera.width * target.pixel_mm if target.pixel_mm else _APERTURE_MM)
        lines += [f'def Camera "{name}"', "{", '    token projection = "perspective"']
        lines += [f"    float {key} = {value!r}" for key, value in values.items()]
        lines.append("    float2 clippingRange = (0.1, 1000000)")
        if named.camera_from_world is not None:
            rows = world_from_eye(named.camera_from_world, _UNIT_MM).T
            text = ", ".join(f"({', '.join(map(repr, numbers(row)))})" for row in rows)
            lines += [
                f"    matrix4d xformOp:transform = ( {text} )",
                '    uniform token[] xformOpOrder = ["xformOp:transform"]',
            ]
        lines += ["}", ""]
    lines += ['def Scope "Render"', "{"]
    for name, named in zip(names, cameras, strict=True):
        lines += [
            f'    def RenderProduct "{name}"',
            "    {",
            f"        rel camera = </{name}>",
            f"        uniform int2 resolution = ({named.camera.width}, {named.camera.height})",
            f"        uniform float pixelAspectRatio = {named.camera.fy / named.camera.fx!r}",
            f'        uniform token aspectRatioConformPolicy = "{_KEEPS}"',
            "    }",
        ]
    return {"": "\n".join([*lines, "}", ""]).encode()}


def _values(camera: Camera, aperture: float) -> dict[str, float]:
    (W, H), (cx, cy) = camera.size, camera.principal_point.tolist()
    focal = camera.fx * aperture / W
    vertical = focal * H / camera.fy
    return {
        "focalLength": focal,
        "horizontalAperture": aperture,
        "verticalAperture": vertical,
        "horizontalApertureOffset": (W / 2 - (cx + 0.5)) * aperture / W,
        "verticalApertureOffset": ((cy + 0.5) - H / 2) * vertical / H,
    }


@dataclass(frozen=True, slots=True)
class _Product:
    """What a RenderProduct says of its picture, by default as USD does: size, a pixel's width by its height, policy."""

    size: tuple[int, int]
    pixel_aspect: float = 1.0
    policy: str = _POLICIES[0]

    def apertures(self, width: float, height: float) -> tuple[float, float]:
        """Return the apertures that the picture shows of those of the camera, by the policy."""
        aspect = self.pixel_aspect * self.size[0] / self.size[1]
        wide = width / height > aspect
        if self.policy == _KEEPS:
            return width, height
        if self.policy == "adjustApertureHeight" or (self.policy == "expandAperture" and wide):
            return width, width / aspect
        if self.policy == "adjustApertureWidth" or self.policy == "expandAperture" or wide:
            return height * aspect, height
        return width, width / aspect


def _camera(place: Place, product: _Product) -> Camera:
    if any(name.endswith(".timeSamples") for name in place.object):
        raise place.error("changes with time", "bake one frame and export again")
    if place.object.get("projection", "perspective") != "perspective":
        raise place.error("is not a perspective camera")
    default = {"focalLength": 50.0, "horizontalAperture": 20.955, "verticalAperture": 15.2908}
    default |= {"horizontalApertureOffset": 0.0, "verticalApertureOffset": 0.0}
    f, a, b, da, db = (place.at(n).number() if n in place.object else value for n, value in default.items())
    if not (f > 0 and a > 0 and b > 0):
        raise place.error(f"has focalLength {f:g}, apertures {a:g} and {b:g}", "positive numbers")
    W, H = product.size
    a, b = product.apertures(a, b)
    cx, cy = W / 2 - da * W / a - 0.5, H / 2 + db * H / b - 0.5
    return Camera(product.size, np.array([[f * W / a, 0, cx], [0, f * H / b, cy], [0, 0, 1]]))


def _cameras(prim: Prim, path: str, parent: Array, file: str) -> Iterator[tuple[str, Array, Prim]]:
    """Yield (path, 4x4 for row vectors, prim) of all cameras below a prim."""
    for child in prim.children:
        here = f"{path}/{child.name}"
        place = Place(file, tuple(here.strip("/").split("/")), child.attributes)
        matrix = _local(place) @ parent
        if child.kind == "Camera":
            yield here, matrix, child
        yield from _cameras(child, here, matrix, file)


def _local(place: Place) -> Array:
    """Return the prim's own transform for row vectors: the last of xformOpOrder acts first."""
    order = place.object.get("xformOpOrder", [])
    if not isinstance(order, list) or not all(isinstance(name, str) for name in order):
        raise place.error("has an xformOpOrder that is no list of names")
    out = np.eye(4)
    for name in order:
        out = _operation(place, name) @ out
    return out


def _operation(place: Place, name: str) -> Array:
    """Return one operation (4, 4) for row vectors; "!invert!" before its name undoes one, as of a pivot."""
    if name.startswith(_INVERT):
        return np.asarray(np.linalg.inv(_operation(place, name.removeprefix(_INVERT))), np.float64)
    kind = name.partition(":")[2].partition(":")[0]
    at = place.at(name)
    out = np.eye(4)
    if kind == "transform":
        return at.array((4, 4))
    if kind == "translate":
        out[3, :3] = at.array((3,))
    elif kind == "scale":  # Blender and Omniverse write one of 1 everywhere
        if not np.allclose(at.array((3,)), 1, rtol=0, atol=_FLOAT):
            raise at.error("is not 1", "apply the scale and export again: a camera's place has none")
    elif kind == "orient":
        out[:3, :3] = at.build(lambda: so3.from_quaternion(at.array((4,)))).T
    elif re.fullmatch("rotate[XYZ]", kind):
        out[:3, :3] = _turn("XYZ".index(kind[-1]), at.number())
    elif re.fullmatch("rotate[XYZ]{3}", kind):
        degrees = at.array((3,))
        for axis in ("XYZ".index(letter) for letter in kind[-3:]):
            out[:3, :3] = out[:3, :3] @ _turn(axis, degrees[axis])
    else:
        raise at.error("is not a rotation, a translation or a matrix", "bake the transform and export again")
    return out


def _turn(axis: int, degrees: float) -> Array:
    """Return the rotation about one axis, for row vectors."""
    return np.asarray(so3.exp(np.radians(degrees) * np.eye(3)[axis]).T)


def _products(prim: Prim, file: str) -> dict[str, _Product]:
    """Return what every render product says of its picture, by its camera's path."""
    found: dict[str, _Product] = {}
    for child in prim.children:
        values = child.attributes
        camera, size = values.get("camera"), values.get("resolution", [])
        if child.kind == "RenderProduct" and isinstance(camera, str) and _is_size(size):
            found[camera.strip("<>")] = _product(Place(file, (child.name,), values), (int(size[0]), int(size[1])))
        found |= _products(child, file)
    return found


def _product(place: Place, size: tuple[int, int]) -> _Product:
    policy = place.object.get("aspectRatioConformPolicy", _POLICIES[0])
    if policy not in _POLICIES:
        raise place.error(f"has the aspectRatioConformPolicy {str(policy)[:40]!r}", f"known: {', '.join(_POLICIES)}")
    aspect = place.at("pixelAspectRatio").number() if "pixelAspectRatio" in place.object else 1.0
    if not aspect > 0 or min(size) < 1:
        raise place.error(f"has pixelAspectRatio {aspect:g} and resolution {size}", "positive numbers")
    return _Product(size, aspect, policy)


def _is_size(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(isinstance(v, float) and abs(v) < 1e9 for v in value)


def _identifiers(cameras: Sequence[NamedCamera]) -> list[str]:
    """Return names that are valid in USD: letters, digits and underscores, each once."""
    out: list[str] = []
    for named in cameras:
        name = re.sub(r"\W", "_", named.name, flags=re.ASCII)
        name = name if not name[:1].isdigit() else f"_{name}"
        out.append(name if name not in (*out, "Render") else f"{name}_{len(out)}")
    return out


def _losses(named: NamedCamera) -> list[ConversionLoss]:
    """Return the loss from USD's own rounding of the five numbers to floats."""
    camera = named.camera
    rounded = {key: float(np.float32(value)) for key, value in _values(camera, _APERTURE_MM).items()}
    place = Place("", (), rounded)
    px = largest_difference(camera, replace(camera, K=_camera(place, _Product(camera.size, policy=_KEEPS)).K))
    return [
        ConversionLoss(
            "precision", "the file keeps all digits, but USD itself rounds focal length and apertures to floats", px
        )
    ]


FORMAT = Format(
    name="usd",
    title="USD text",
    suffixes=(".usda",),
    holds=Holds({"ideal": ()}, pose="yes", several=True),
    recognises=recognises,
    read=read,
    write=write,
    unit="cm",
    extra_losses=_losses,
)
