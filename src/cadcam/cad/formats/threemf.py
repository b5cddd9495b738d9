"""3MF: a zip of XML that names its own unit; every object placed by the build is a part."""

from __future__ import annotations

import struct
import zipfile
import zlib
from io import BytesIO
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from cadcam.arrays import Array, Longs
from cadcam.cad.formats.model import Model, assembled, check_indices
from cadcam.errors import UnreadableFile

_AGAIN = "export it again"
_UNIT = {
    "micron": "um",
    "millimeter": "mm",
    "centimeter": "cm",
    "inch": "in",
    "foot": "ft",
    "meter": "m",
}
# what zipfile raises on damaged archives, empirically
_BROKEN = (zipfile.BadZipFile, zlib.error, struct.error, EOFError, OSError, RuntimeError, ValueError)
_MOST = 100_000  # placed objects: ten levels of ten components each are ten thousand million, in a kilobyte
_LARGEST = 4 << 30  # bytes of XML: more is a decompression bomb, not a model


def read_3mf(path: Path, data: bytes) -> Model:
    """Return the objects that the build of the package places, in the unit that the package names."""
    package = _Package(path, data)
    root = package.model(package.start)
    unit = root.get("unit", "millimeter")
    if unit not in _UNIT:
        raise UnreadableFile(path, f"names the unit {unit!r}", f"3MF knows {', '.join(_UNIT)}")
    items = [
        (package.start_of(item.attrib, package.start), item.get("objectid", ""), _matrix(path, item.get("transform")))
        for item in root.iterfind("./{*}build/{*}item")
    ]
    found = _Collected()
    for model, number, place in items:
        package.place(found, model, number, place, "", 0)
    points = np.concatenate([np.zeros((0, 3)), *found.points])
    faces = np.concatenate([np.zeros((0, 3), np.int64), *found.faces])
    part = np.repeat(np.arange(len(found.faces)), [len(f) for f in found.faces])
    colors = np.concatenate([np.zeros((0, 3)), *found.colors])
    mesh = assembled(path, points, faces, part=part, names=found.names, face_colors=colors)
    return Model(mesh, _UNIT[unit], declared="unit" in root.attrib)


class _Collected:
    def __init__(self) -> None:
        self.points: list[Array] = []
        self.faces: list[Longs] = []
        self.names: list[str] = []
        self.colors: list[Array] = []
        self.n_points = 0
        self.placed = 0


class _Package:
    """The models of a 3MF package, parsed when first asked for."""

    def __init__(self, path: Path, data: bytes) -> None:
        self.path = path
        try:
            self.zip = zipfile.ZipFile(BytesIO(data))
        except _BROKEN as error:
            raise UnreadableFile(path, f"is not a complete zip archive ({error}): truncated", _AGAIN) from None
        self.models: dict[str, ElementTree.Element] = {}
        self.meshes: dict[tuple[str, str], tuple[Array, Longs, Array]] = {}
        self._objects: dict[str, dict[str, ElementTree.Element]] = {}
        names = [n for n in self.zip.namelist() if n.lower().endswith(".model")]
        if not names:
            raise UnreadableFile(path, "holds no 3D model", _AGAIN)
        self.start = self._start(names)

    def _start(self, names: list[str]) -> str:
        """Return the model that the package's relations name first, else the usual one."""
        try:
            for relation in ElementTree.fromstring(self.zip.read("_rels/.rels")):
                if relation.get("Type", "").endswith("/3dmodel"):
                    target = relation.get("Target", "").lstrip("/")
                    if target in names:
                        return target
        except (KeyError, ElementTree.ParseError, *_BROKEN):
            pass  # the relations are optional; the model itself decides
        return next((n for n in names if n.lower() == "3d/3dmodel.model"), names[0])

    def start_of(self, attributes: dict[str, str], current: str) -> str:
        """Return the model that an item or component refers to (production extension), else the current one."""
        target = next((v for k, v in attributes.items() if k.endswith("}path")), "")
        return target.lstrip("/") or current

    def model(self, name: str) -> ElementTree.Element:
        """Return the XML of a model."""
        if name not in self.models:
            try:
                if self.zip.getinfo(name).file_size > _LARGEST:
                    raise UnreadableFile(self.path, f"{name} unpacks to more than {_LARGEST >> 30} GiB", _AGAIN)
                self.models[name] = ElementTree.fromstring(self.zip.read(name))
            except KeyError:
                raise UnreadableFile(self.path, f"refers to {name!r}, which it does not hold", _AGAIN) from None
            except _BROKEN as error:
                raise UnreadableFile(self.path, f"{name} cannot be unpacked ({error})", _AGAIN) from None
            except ElementTree.ParseError as error:
                raise UnreadableFile(self.path, f"{name} is not valid XML ({error})", _AGAIN) from None
        return self.models[name]

    def objects(self, name: str) -> dict[str, ElementTree.Element]:
        """Return the objects of a model by their number; of two with one number the first."""
        if name not in self._objects:
            listed = [(o.get("id", ""), o) for o in self.model(name).iterfind("./{*}resources/{*}object")]
            self._objects[name] = dict(reversed(listed))
        return self._objects[name]

    def place(self, found: _Collected, model: str, number: str, place: Array, above: str, depth: int) -> None:
        """Add the object and, where it is an assembly, its components."""
        if depth > 50:
            raise UnreadableFile(self.path, f"object {number} contains itself", _AGAIN)
        found.placed += 1
        if found.placed > _MOST:
            what = f"its components of components place more than {_MOST} objects"
            raise UnreadableFile(self.path, what, "is it meant to hold so many?")
        item = self.objects(model).get(number)
        if item is None:
            raise UnreadableFile(self.path, f"the build refers to object {number!r}, which is not there", _AGAIN)
        name = item.get("name") or above or f"object {number}"
        for component in item.iterfind("./{*}components/{*}component"):
            inner = place @ _matrix(self.path, component.get("transform"))
            target = self.start_of(component.attrib, model)
            self.place(found, target, component.get("objectid", ""), inner, name, depth + 1)
        mesh = item.find("./{*}mesh")
        if mesh is None:
            return
        if (model, number) not in self.meshes:  # a bolt may stand in a hundred places
            self.meshes[model, number] = (*self._mesh(mesh, name), _face_colors(self.model(model), item, mesh))
        _add(found, self.meshes[model, number], place, name)

    def _mesh(self, mesh: ElementTree.Element, name: str) -> tuple[Array, Longs]:
        """Return the vertices (V, 3) and triangles (F, 3) of an object."""
        try:
            points = np.array([[v.get(k) for k in "xyz"] for v in mesh.iterfind("./{*}vertices/{*}vertex")], float)
            faces = np.array(
                [[t.get(k) for k in ("v1", "v2", "v3")] for t in mesh.iterfind("./{*}triangles/{*}triangle")]
            ).astype(np.int64)
        except (TypeError, ValueError, OverflowError) as error:
            raise UnreadableFile(self.path, f"object {name!r} holds a number it should not ({error})", _AGAIN) from None
        points, faces = points.reshape(-1, 3), faces.reshape(-1, 3)
        check_indices(self.path, faces, len(points), lambda at: f"object {name!r}, triangle {at}")
        return points, faces


@np.errstate(over="ignore", invalid="ignore")  # coordinates that are no numbers are refused with their place
def _add(found: _Collected, mesh: tuple[Array, Longs, Array], place: Array, name: str) -> None:
    points, faces, colors = mesh
    if not len(faces):
        return
    if np.linalg.det(place[:3, :3]) < 0:
        faces = faces[:, ::-1]
    found.points.append(points @ place[:3, :3].T + place[:3, 3])
    found.faces.append(faces + found.n_points)
    found.names.append(name)
    found.colors.append(colors)
    found.n_points += len(points)


def _matrix(path: Path, text: str | None) -> Array:
    """Return the 4x4 of a 3MF transform: twelve numbers, rows of a matrix that acts on row vectors."""
    place = np.eye(4)
    if text:
        try:
            place[:3] = np.array(text.split(), float).reshape(4, 3).T
        except ValueError:
            raise UnreadableFile(path, f"the transform {text[:60]!r} is not twelve numbers", _AGAIN) from None
    return place


def _face_colors(root: ElementTree.Element, item: ElementTree.Element, mesh: ElementTree.Element) -> Array:
    """Return the RGB of each triangle: the mean of its corners' colours, its own or its object's; NaN without any."""
    groups = _color_groups(root)
    home = (item.get("pid", ""), item.get("pindex", "0"))
    rows = []
    for triangle in mesh.iterfind("./{*}triangles/{*}triangle"):
        group, first = triangle.get("pid", home[0]), triangle.get("p1")
        if first is None:  # without an index of its own it has its object's colour
            rows.append(_of_group(groups, *home))
        else:
            corners = (first, triangle.get("p2", first), triangle.get("p3", first))
            rows.append(np.mean([_of_group(groups, group, index) for index in corners], axis=0))
    return np.array(rows).reshape(-1, 3)


def _of_group(groups: dict[str, list[Array]], group: str, index: str) -> Array:
    colors = groups.get(group, [])
    return colors[int(index)] if index.isdecimal() and int(index) < len(colors) else np.full(3, np.nan)


def _color_groups(root: ElementTree.Element) -> dict[str, list[Array]]:
    """Return the colours of base materials and colour groups (materials extension) by the group's number."""
    groups = {}
    for kind, attribute in (("basematerials", "displaycolor"), ("colorgroup", "color")):
        for group in root.iterfind(f"./{{*}}resources/{{*}}{kind}"):
            groups[group.get("id", "")] = [_rgb(entry.get(attribute, "")) for entry in group]
    return groups


def _rgb(text: str) -> Array:
    try:
        return np.array([int(text[k : k + 2], 16) / 255 for k in (1, 3, 5)])
    except ValueError:
        return np.full(3, np.nan)
