"""COLLADA 1.4 and 1.5 (.dae): XML with a tree of placed geometries, as robots' descriptions have them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from cadcam.arrays import Array, Longs
from cadcam.cad.formats.gltf import Primitive, Shape, collected
from cadcam.cad.formats.model import Model, check_indices
from cadcam.cad.formats.polygons import fan, strip, triangulated
from cadcam.cad.units import MM
from cadcam.errors import UnreadableFile
from cadcam.geometry.rigid import Rigid

_AGAIN = "export it again"
_DEEPEST, _MOST = 50, 100_000  # nodes in each other; nodes and geometries placed: more are a mistake, or an attack
_SAME = 1e-6  # share by which a unit's length may differ from that of the unit it is taken for


def read_collada(path: Path, data: bytes) -> Model:
    """Return what the scene places; each placed geometry is a part, lines are ignored. Axes are as in the file.

    Numbers are in the unit that the file names by its length; where it gives no length, metres by the rule of the
    format. The colour of a face is its material's diffuse one; textures, skins and animations are ignored. Raises
    `UnreadableFile`. Source: COLLADA 1.4.1 and 1.5.0 (Khronos).
    """
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise UnreadableFile(path, f"is not valid XML ({error})", _AGAIN) from None
    if not root.tag.endswith("COLLADA"):
        raise UnreadableFile(path, f"is XML, but <{root.tag.rpartition('}')[2]}>, not COLLADA", "check the suffix")
    document = _Document(path, root)
    try:
        unit, per_unit, declared = _unit(root)
        mesh = collected(path, list(document.shapes(per_unit)), brep=False)
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise UnreadableFile(path, f"its XML is inconsistent ({type(error).__name__}: {error})", _AGAIN) from None
    skins = len(root.findall(".//{*}instance_controller"))
    notes = (f"{skins} skinned geometr{'ies are' if skins > 1 else 'y is'} left out",) if skins else ()
    return Model(mesh, unit, declared, notes)


def _unit(root: Element) -> tuple[str, float, bool]:
    """Return the unit of the numbers, by what they are to be multiplied for that, and whether the file states it."""
    unit = root.find("./{*}asset/{*}unit")
    if unit is None or "meter" not in unit.attrib:
        return "m", 1.0, False
    metres = float(unit.attrib["meter"])
    if not 0 < metres < np.inf:
        raise ValueError(f"a unit of {metres:g} m")
    for name, mm in MM.items():
        if abs(metres * 1000 - mm) <= _SAME * mm:
            return name, 1.0, True
    return "m", metres, True


@dataclass(slots=True, eq=False)
class _Document:
    path: Path
    root: Element
    _by_id: dict[str, Element] = field(default_factory=dict)
    _read: dict[int, list[tuple[str, Primitive]]] = field(default_factory=dict)  # a geometry may be placed often
    _placed: int = 0

    def __post_init__(self) -> None:
        for element in self.root.iter():
            if "id" in element.attrib:
                self._by_id.setdefault(element.attrib["id"], element)

    def shapes(self, per_unit: float) -> Iterator[Shape]:
        """Yield the geometries that the scene places or, of a library without a scene, all; scaled by `per_unit`."""
        scene = self.root.find("./{*}scene/{*}instance_visual_scene")
        top = self.root.find(".//{*}visual_scene") if scene is None else self._target(scene)
        world = np.diag([per_unit, per_unit, per_unit, 1.0])
        if top is not None:
            yield from self._below(top, world, ())
        else:
            for geometry in self.root.iterfind("./{*}library_geometries/{*}geometry"):
                yield self._shape(geometry, {}, world, ("",))

    def _below(self, node: Element, world: Array, names: tuple[str, ...]) -> Iterator[Shape]:
        """Yield the geometries of a node and of those below it; world (4, 4): world_from_parent."""
        if len(names) > _DEEPEST:
            raise UnreadableFile(self.path, f"node {names[-1]!r} stands below itself", _AGAIN)
        self._count()
        names = (*names, node.get("name") or node.get("id") or "")
        for child in node:
            kind = child.tag.rpartition("}")[2]
            if kind in _PLACING:
                world = world @ _placement(kind, child)
            elif kind in ("lookat", "skew"):
                raise UnreadableFile(self.path, f"node {names[-1]!r} is placed by <{kind}>", "export it with matrices")
            elif kind == "node":
                yield from self._below(child, world, names)
            elif kind == "instance_node":
                yield from self._below(self._target(child), world, names)
            elif kind == "instance_geometry":
                colors = {m.get("symbol", ""): self._color(m) for m in child.iterfind(".//{*}instance_material")}
                yield self._shape(self._target(child), colors, world, names)

    def _shape(self, geometry: Element, colors: dict[str, Array], world: Array, names: tuple[str, ...]) -> Shape:
        self._count()
        key = id(geometry)  # the element's own: not all have a name
        if key not in self._read:
            self._read[key] = list(self._primitives(geometry))
        none = np.full(3, np.nan)
        primitives = [
            Primitive(p.points, p.faces, None, np.tile(colors.get(material, none), (len(p.faces), 1)))
            for material, p in self._read[key]
        ]
        return Shape(names, world, geometry.get("name", ""), primitives)

    def _count(self) -> None:
        self._placed += 1
        if self._placed > _MOST:
            what = f"places more than {_MOST} nodes and geometries"
            raise UnreadableFile(self.path, what, "is it meant to hold so many?")

    def _primitives(self, geometry: Element) -> Iterator[tuple[str, Primitive]]:
        """Yield the surfaces of a geometry, each with the symbol of its material and without colours."""
        for one in geometry.iterfind("./{*}mesh/*"):
            kind = one.tag.rpartition("}")[2]
            if kind not in ("triangles", "polylist", "polygons", "tristrips", "trifans"):
                continue
            points, corners = self._corners(one)
            what = f"geometry {geometry.get('name') or geometry.get('id')!r}, corner {{}}"
            check_indices(self.path, np.concatenate([np.zeros(0, np.int64), *corners]), len(points), what.format)
            faces = _faces(kind, one, points, corners)
            used, faces = np.unique(faces, return_inverse=True)
            shape = faces.reshape(-1, 3)
            yield one.get("material", ""), Primitive(points[used], shape, None, np.zeros((len(shape), 3)))

    def _corners(self, surfaces: Element) -> tuple[Array, list[Longs]]:
        """Return points (V, 3) and, of each list of corners, the points' numbers."""
        inputs = surfaces.findall("./{*}input")
        at = next((one for one in inputs if one.get("semantic") == "VERTEX"), None)
        if surfaces.find("./{*}ph") is not None:
            raise UnreadableFile(self.path, "holds polygons with holes", "export it as triangles")
        lists = surfaces.findall("./{*}p")
        if at is None or not lists:
            return np.zeros((0, 3)), []
        stride = 1 + max(int(one.get("offset", 0)) for one in inputs)
        rows = [np.array((p.text or "").split(), np.int64).reshape(-1, stride) for p in lists]
        position = self._target(at, "source").find("./{*}input[@semantic='POSITION']")
        if position is None:
            raise UnreadableFile(self.path, f"has vertices {at.get('source')!r} without positions", _AGAIN)
        return self._vectors(self._target(position, "source")), [row[:, int(at.get("offset", 0))] for row in rows]

    def _vectors(self, source: Element) -> Array:
        """Return the rows (V, 3) of a source of positions."""
        numbers = np.array((source.findtext("./{*}float_array") or "").split(), float)
        accessor = source.find("./{*}technique_common/{*}accessor")
        told = {} if accessor is None else accessor.attrib
        stride, offset = int(told.get("stride", 3)), int(told.get("offset", 0))
        count = int(told.get("count", (len(numbers) - offset) // max(stride, 1)))
        if min(count, offset) < 0 or stride < 3 or offset + count * stride > len(numbers):
            what = f"source {source.get('id')!r} claims {count} positions of {stride} numbers, but has {len(numbers)}"
            raise UnreadableFile(self.path, f"{what}: truncated", _AGAIN)
        return numbers[offset : offset + count * stride].reshape(count, stride)[:, :3]

    def _color(self, instance: Element) -> Array:
        """Return the diffuse colour (3,) of a placed material; NaN without one."""
        material = self._by_id.get(instance.get("target", "").lstrip("#"))
        effect = None if material is None else material.find("./{*}instance_effect")
        shader = None if effect is None else self._by_id.get(effect.get("url", "").lstrip("#"))
        color = None if shader is None else shader.find(".//{*}diffuse/{*}color")
        if color is None:
            return np.full(3, np.nan)
        return np.asarray(np.clip(np.array((color.text or "").split()[:3], float).reshape(3), 0, 1))

    def _target(self, element: Element, attribute: str = "url") -> Element:
        """Return what an element of the file refers to."""
        name = element.get(attribute, "")
        if not name.startswith("#"):
            raise UnreadableFile(self.path, f"refers to {name!r}, outside the file", "export it as one file")
        if name[1:] not in self._by_id:
            raise UnreadableFile(self.path, f"refers to {name[1:]!r}, which it does not hold", _AGAIN)
        return self._by_id[name[1:]]


_PLACING = {"matrix": 16, "translate": 3, "rotate": 4, "scale": 3}  # elements, and how many numbers each has


def _placement(kind: str, element: Element) -> Array:
    """Return the matrix (4, 4) of an element that places what follows it."""
    told = np.array((element.text or "").split(), float).reshape(_PLACING[kind])
    place = np.eye(4)
    if kind == "matrix":
        return np.asarray(told.reshape(4, 4))
    if kind == "translate":
        place[:3, 3] = told
    elif kind == "scale":
        place[:3, :3] = np.diag(told)
    elif (length := np.linalg.norm(told[:3])) > 0:  # an axis, and an angle in degrees
        place[:3, :3] = Rigid.exp([0, 0, 0, *(np.radians(told[3]) / length * told[:3])]).rotation
    return place


def _faces(kind: str, surfaces: Element, points: Array, corners: list[Longs]) -> Longs:
    """Return the triangles (T, 3) that lists of corners stand for."""
    if not corners:
        return np.zeros((0, 3), np.int64)
    if kind in ("tristrips", "trifans"):
        return np.concatenate([strip(one) if kind == "tristrips" else fan(one) for one in corners])
    every = np.concatenate(corners)
    if kind == "triangles":
        return every[: len(every) // 3 * 3].reshape(-1, 3)
    if kind == "polygons":
        counts = np.array([len(one) for one in corners], np.int64)
    else:
        counts = np.array((surfaces.findtext("./{*}vcount") or "").split(), np.int64)
        if (counts < 0).any() or counts.sum() != len(every):
            raise ValueError(f"polygons of {counts.sum()} corners, but {len(every)} are listed")
    return triangulated(points, counts, every)[0]
