"""Triangle meshes in millimetres: the result of all loaders and the input of every renderer."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids, Locked, Mask, frozen
from cadcam.errors import BadValue, DegenerateGeometry
from cadcam.geometry.rigid import Rigid, expect_motion
from cadcam.kinds import expect_known, expect_positive, said


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Mesh(Locked):
    """Triangles in mm, counter-clockwise seen from outside, each with the part and the surface it belongs to.

    `vertices` (V, 3) mm; `faces` (F, 3) rows of vertex indices; `part` (F,) index into `part_names`; `surface` (F,)
    number of the smooth (B-rep) surface that a face approximates, -1 where the file has none; `part_colors` (P, 3) RGB
    in [0, 1], NaN where the file has none; `corner_normals` (F, 3, 3) unit normals of the true surface at the three
    corners of each face, or None where the file has none; `face_colors` (F, 3) RGB of faces that differ from their
    part, NaN for those that do not, or None where all are alike. Raises `BadValue` on indices out of range and numbers
    that are not finite.
    """

    vertices: Array
    faces: Ids
    part: Ids
    surface: Ids
    part_names: tuple[str, ...]
    part_colors: npt.NDArray[np.float32]
    corner_normals: npt.NDArray[np.float32] | None = None
    face_colors: npt.NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        vertices = frozen(self.vertices, "mesh vertices", (None, 3))
        faces = _indices(self.faces, "mesh faces", (None, 3), 0, len(vertices))
        names = tuple(self.part_names)
        n = len(faces)
        part = _indices(self.part, "mesh part", (None,), 0, len(names))
        surface = _indices(self.surface, "mesh surface", (None,), -1, np.iinfo(np.int32).max)
        for what, ids in (("mesh part", part), ("mesh surface", surface)):
            if len(ids) != n:
                raise BadValue(what, f"{len(ids)} long", f"one entry for each of the {n} faces")
        colors = frozen(self.part_colors, "mesh part_colors", (None, 3), np.float32, finite=False)
        if len(colors) != len(names):
            raise BadValue("mesh part_colors", f"{len(colors)} long", f"one for each of the {len(names)} parts")
        normals = self.corner_normals
        if normals is not None:
            normals = frozen(normals, "mesh corner_normals", (None, 3, 3), np.float32)
            if len(normals) != n:
                raise BadValue("mesh corner_normals", f"{len(normals)} long", f"one for each of the {n} faces")
        paint = self.face_colors
        if paint is not None:
            paint = frozen(paint, "mesh face_colors", (None, 3), np.float32, finite=False)
            if len(paint) != n:
                raise BadValue("mesh face_colors", f"{len(paint)} long", f"one for each of the {n} faces")
        values = (vertices, faces, part, surface, names, colors, normals, paint)
        for field, value in zip(self.__slots__, values, strict=True):
            object.__setattr__(self, field, value)

    @classmethod
    def single(
        cls,
        vertices: npt.ArrayLike,
        faces: npt.ArrayLike,
        *,
        name: str = "part",
        surface: npt.ArrayLike | None = None,
        color: npt.ArrayLike | None = None,
    ) -> Mesh:
        """Return a mesh of one part; `surface` is -1 throughout and `color` NaN unless given."""
        corners = np.asarray(faces)
        if corners.ndim != 2:
            raise BadValue("faces", said(faces), "vertex indices of shape (F, 3)")
        n = len(corners)
        return cls(
            vertices=frozen(vertices, "vertices", (None, 3)),
            faces=corners,
            part=np.zeros(n, np.int32),
            surface=np.full(n, -1, np.int32) if surface is None else np.asarray(surface),
            part_names=(name,),
            part_colors=np.full((1, 3), np.nan, np.float32) if color is None else np.asarray(color, np.float32)[None],
        )

    @property
    def n_faces(self) -> int:
        """Number of triangles."""
        return len(self.faces)

    @property
    def bounds(self) -> Array:
        """Lowest and highest corner (2, 3) in mm of the box around all faces; unused vertices do not count."""
        if not self.n_faces:
            raise DegenerateGeometry("a mesh without faces has no size")
        used = self.vertices[used_vertices(self)]
        return np.stack([used.min(axis=0), used.max(axis=0)])

    @property
    def box_corners(self) -> Array:
        """The corners (8, 3) in mm of that box."""
        low, high = self.bounds
        return np.asarray(np.where(np.indices((2, 2, 2)).reshape(3, -1).T, high, low))

    @property
    def size_mm(self) -> Array:
        """Extent (3,) along x, y, z in mm."""
        low, high = self.bounds
        return np.asarray(high - low)

    @property
    def face_normals(self) -> Array:
        """Outward unit normals (F, 3); zero where a face has no area. Computed at every call."""
        cross = _cross(self)
        length = np.linalg.norm(cross, axis=1, keepdims=True)
        return np.asarray(cross / np.where(length > 0, length, 1))

    @property
    def face_areas(self) -> Array:
        """Areas (F,) in mm². Computed at every call."""
        return np.asarray(np.linalg.norm(_cross(self), axis=1) / 2)

    @property
    def colors_of_faces(self) -> npt.NDArray[np.float32]:
        """RGB (F, 3) in [0, 1] of each face, its own or its part's; NaN where neither is known."""
        of_parts = self.part_colors[self.part]
        if self.face_colors is None:
            return of_parts
        return np.where(np.isnan(self.face_colors), of_parts, self.face_colors)

    def transformed(self, b_from_a: Rigid) -> Mesh:
        """Return the mesh, given in frame a, in frame b."""
        expect_motion(b_from_a, "b_from_a")
        normals = self.corner_normals
        if normals is not None:
            normals = np.asarray(normals @ np.asarray(b_from_a.rotation).T, np.float32)
        return replace(self, vertices=np.asarray(b_from_a @ self.vertices), corner_normals=normals)

    def scaled(self, factor: float) -> Mesh:
        """Return the mesh scaled by `factor` about the origin; the factor is positive and finite."""
        expect_positive(factor, "scale factor")
        return replace(self, vertices=self.vertices * factor)

    def subset(self, parts: Iterable[str | int]) -> Mesh:
        """Return only the named (or numbered) parts, in their old order, without the vertices of the others."""
        wanted = {self._part_index(p) for p in parts}
        kept = sorted(wanted)
        number = np.full(len(self.part_names), -1, np.int32)
        number[kept] = np.arange(len(kept))
        chosen = self.select(np.isin(self.part, kept))
        return replace(
            chosen,
            part=number[chosen.part],
            part_names=tuple(self.part_names[i] for i in kept),
            part_colors=self.part_colors[kept],
        )

    def select(self, faces: Mask | Ids) -> Mesh:
        """Return the mesh with the chosen faces only (mask or indices); parts keep their numbers."""
        return compacted(
            replace(
                self,
                faces=self.faces[faces],
                part=self.part[faces],
                surface=self.surface[faces],
                corner_normals=None if self.corner_normals is None else self.corner_normals[faces],
                face_colors=None if self.face_colors is None else self.face_colors[faces],
            )
        )

    def _part_index(self, part: str | int) -> int:
        if isinstance(part, str):
            expect_known(part, "part", self.part_names)
            return self.part_names.index(part)
        if not 0 <= part < len(self.part_names):
            raise BadValue("part number", part, f"0 to {len(self.part_names) - 1}")
        return part

    def __repr__(self) -> str:
        parts = f"{len(self.part_names)} part{'s' * (len(self.part_names) != 1)}"
        size = " x ".join(f"{x:.6g}" for x in self.size_mm) if len(self.vertices) else "0"
        return f"Mesh({parts}, {len(self.vertices)} vertices, {self.n_faces} faces, {size} mm)"


def merge(meshes: Sequence[Mesh]) -> Mesh:
    """Return one mesh holding the parts of all, in order; repeated part names get a number, surfaces stay distinct."""
    if not meshes:
        raise BadValue("number of meshes", 0, "at least one")
    first_vertex = np.cumsum([0] + [len(m.vertices) for m in meshes])
    first_part = np.cumsum([0] + [len(m.part_names) for m in meshes])
    first_surface = np.cumsum([0] + [int(m.surface.max(initial=-1)) + 1 for m in meshes])
    return Mesh(
        vertices=np.concatenate([m.vertices for m in meshes]),
        faces=np.concatenate([m.faces + np.int64(v) for m, v in zip(meshes, first_vertex[:-1], strict=True)]),
        part=np.concatenate([m.part + p for m, p in zip(meshes, first_part[:-1], strict=True)]),
        surface=np.concatenate(
            [np.where(m.surface < 0, -1, m.surface + s) for m, s in zip(meshes, first_surface[:-1], strict=True)]
        ),
        part_names=unique_names([name for m in meshes for name in m.part_names]),
        part_colors=np.concatenate([m.part_colors for m in meshes]),
        corner_normals=_merged_normals(meshes),
        face_colors=_merged_face_colors(meshes),
    )


def _merged_normals(meshes: Sequence[Mesh]) -> npt.NDArray[Any] | None:
    """Return the normals at the corners of all meshes; None unless each of them has some."""
    normals = [m.corner_normals for m in meshes if m.corner_normals is not None]
    return np.concatenate(normals) if len(normals) == len(meshes) else None


def _merged_face_colors(meshes: Sequence[Mesh]) -> npt.NDArray[Any] | None:
    """Return the colours of all faces, NaN for those of meshes without any; None if no mesh has some."""
    if all(m.face_colors is None for m in meshes):
        return None
    unpainted = np.full((1, 3), np.nan, np.float32)
    return np.concatenate([unpainted.repeat(m.n_faces, 0) if m.face_colors is None else m.face_colors for m in meshes])


def unique_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names with " #2", " #3" ... appended to repeated ones, so that each names one part."""
    taken: set[str] = set()
    counts: dict[str, int] = {}
    result = []
    for name in names:
        unique = name
        while unique in taken:
            counts[name] = counts.get(name, 1) + 1
            unique = f"{name} #{counts[name]}"
        taken.add(unique)
        result.append(unique)
    return tuple(result)


def used_vertices(mesh: Mesh) -> Mask:
    """Return the mask (V,) of vertices that some face refers to."""
    used = np.zeros(len(mesh.vertices), bool)
    used[mesh.faces.ravel()] = True
    return used


def compacted(mesh: Mesh) -> Mesh:
    """Return the mesh without the vertices that no face refers to."""
    used = used_vertices(mesh)
    if used.all():
        return mesh
    number = np.cumsum(used, dtype=np.int32) - 1
    return replace(mesh, vertices=mesh.vertices[used], faces=number[mesh.faces])


def _cross(mesh: Mesh) -> Array:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return np.asarray(np.cross(b - a, c - a))


def _indices(values: npt.ArrayLike, what: str, shape: tuple[int | None, ...], low: int, high: int) -> Ids:
    """Return int32 indices in [low, high); checked before the cast, which would wrap silently."""
    array = np.asarray(values)
    if array.size == 0:
        array = np.zeros([n or 0 for n in shape], np.int32)
    if array.dtype.kind not in "iu":
        raise BadValue(what, f"of type {array.dtype}", "whole numbers")
    if array.size and (int(array.min()) < low or int(array.max()) >= high):
        at = tuple(int(i) for i in np.argwhere((array < low) | (array >= high))[0])
        raise BadValue(f"{what}{list(at)}", int(array[at]), f"a whole number from {low} to {high - 1}")
    return frozen(array, what, shape, np.int32)
