"""What each pixel of a photo shows of a part at a pose: which face, its normal, colour and body."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from cadcam.arrays import Array, Ids, Longs, Mask
from cadcam.cad.edges import NO_EDGES
from cadcam.cad.mesh import Mesh
from cadcam.cad.topology import components
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.quality.light import EVERY, FittedLight, light_of, surfaces
from cadcam.render import open_renderer
from cadcam.render.view import Channel, Scene

Window = tuple[slice, slice]
_ROUND_STEPS = 1.0  # quantisation of normals, steps per unit, within which a round surface is one patch


@dataclass(frozen=True, eq=False)
class ShownFaces:
    """What a part shows in the pixels of a photo, or of a window of it.

    face (h, w): index of the face among the n visible ones, 0 where the part is not seen. For these: normal (n, 3) in
    the part frame, turned to the camera; color and part (n,); surface (n,): equal for faces of one colour and similar
    normal; patch (n,): equal for connected ones of a part that face roughly one way. Entry 0: normal zero, colour and
    part -1.
    """

    face: Ids
    normal: Array
    color: Ids
    part: Ids
    surface: Longs
    patch: Longs

    @classmethod
    def of(
        cls,
        part: Part,
        photo: Photo,
        world_from_part: Rigid,
        *,
        without: int = -1,
        window: Window | None = None,
    ) -> ShownFaces:
        """Return what a part at a pose shows in a photo, or in a window of it, the body `without` left out."""
        mesh, camera, camera_from_part = part.scene.mesh, photo.camera, photo.camera_from_world @ world_from_part
        kept = mesh.part != without
        if window is not None:
            camera = camera.crop(*in_window(window))
            kept &= may_show(mesh, camera, camera_from_part)  # a renderer of all faces costs more than the window
        if kept.any():
            scene = part.scene if kept.all() else Scene.of(mesh.select(kept), edges=NO_EDGES)
            seen = open_renderer(scene).render(camera, camera_from_part, channels=Channel.FACE).face
        else:  # a part that is a single body, or nothing of it in the window
            seen = np.full((camera.height, camera.width), -1, np.int32)
        return cls._of_faces(part, np.flatnonzero(kept), seen, camera_from_part.inv.translation)

    @classmethod
    def _of_faces(cls, part: Part, kept: Longs, seen: Ids, eye: Array) -> ShownFaces:
        """Return what is seen where the faces `seen` (h, w), of those `kept` of the part, meet the pixels."""
        among = np.zeros(len(kept) + 1, bool)
        among[seen] = True  # -1, no face, is the last
        which = np.flatnonzero(among[:-1])
        number = np.zeros(len(kept) + 1, np.int32)
        number[which] = np.arange(1, len(which) + 1)
        faces = kept[which]
        mesh = part.scene.mesh
        normal = np.concatenate([np.zeros((1, 3)), _towards(mesh, faces, eye)])
        color, of = (np.append(np.int32(-1), x[faces]).astype(np.int32) for x in (part.paints, mesh.part))
        patch = np.append(-1, _patches(mesh.faces[faces], surfaces(normal, color, steps=_ROUND_STEPS)[1:], of[1:]))
        return cls(number[seen], normal, color, of, surfaces(normal, color), patch)

    def shows(self, body: int) -> Mask:
        """Return which pixels (h, w) show part number `body`."""
        out, box = np.zeros(self.face.shape, bool), self.window(body, 0)
        if box is not None:
            out[box] = (self.part == body)[self.face[box]]
        return out

    def window(self, body: int, room: int) -> Window | None:
        """Return the rows and columns of the box around part number `body`, with some room (px); None if unseen."""
        box = self._boxes[body] if 0 <= body < len(self._boxes) else None
        return None if box is None else _widened(box, room, self.face.shape)

    def own_border(self, part: Part, photo: Photo, world_from_part: Rigid, body: int) -> int:
        """Return along how many pixels part number `body` ends in view, rather than where something hides the rest."""
        from scipy.ndimage import binary_dilation

        window = self.window(body, 1)
        if window is None:
            return 0
        own = Scene.of(part.scene.mesh.select(part.scene.mesh.part == body), edges=NO_EDGES)
        camera, camera_from_part = photo.camera.crop(*in_window(window)), photo.camera_from_world @ world_from_part
        whole = open_renderer(own).render(camera, camera_from_part, channels=Channel.FACE).face >= 0
        here = self.shows(body)[window]
        return int(np.count_nonzero(binary_dilation(here) & ~here & ~whole))

    @cached_property
    def _boxes(self) -> list[Window | None]:
        """The box of each body, as far as any has pixels: found at once, for the picture may be large, bodies many."""
        from scipy.ndimage import find_objects

        return [None if box is None else (box[0], box[1]) for box in find_objects((self.part + 1)[self.face])]

    def uncovered(self, part: Part, photo: Photo, world_from_part: Rigid, body: int) -> ShownFaces:
        """Return what the same part shows in the same photo without a body: elsewhere than where that is, the same."""
        window = self.window(body, 0)
        if window is None:
            return self
        behind = ShownFaces.of(part, photo, world_from_part, without=body, window=window)
        return self._with(behind, window, self.shows(body)[window])

    def moved(self, part: Part, photo: Photo, world_from_part: Rigid, body: int) -> ShownFaces:
        """Return what a part shows in the same photo that differs by the place of a body alone.

        Elsewhere than where that is, and was, it is the same.
        """
        own = Scene.of(part.scene.mesh.select(part.scene.mesh.part == body), edges=NO_EDGES)
        camera_from_part = photo.camera_from_world @ world_from_part
        reached = open_renderer(own).render(photo.camera, camera_from_part, channels=Channel.FACE).face >= 0
        was = self.window(body, 0)
        if was is not None:
            reached[was] = True
        if not reached.any():
            return self
        window = window_around(reached, 0)
        return self._with(ShownFaces.of(part, photo, world_from_part, window=window), window, np.array(True))

    def _with(self, other: ShownFaces, window: Window, where: Mask) -> ShownFaces:
        """Return it with what another shows in a window in place of its own, `where` (h, w) that is asked for."""
        face = self.face.copy()
        face[window] = np.where(where, len(self.part) + other.face, face[window])
        of_faces = ("normal", "color", "part", "surface", "patch")
        apart = replace(other, patch=other.patch + len(self.part) + 1)
        return ShownFaces(face, *(np.concatenate([getattr(self, k), getattr(apart, k)]) for k in of_faces))

    def light(self, photo: Photo, *, without: Mask | None = None) -> FittedLight:
        """Return the light that explains a whole photo; without (H, W): pixels left out."""
        few = slice(None, None, EVERY)
        gray, face = photo.gray[few, few].ravel(), self.face[few, few].ravel()
        if without is not None:
            counts = ~without[few, few].ravel()
            gray, face = gray[counts], face[counts]
        return light_of(gray.astype(np.float64), self.normal[face], self.color[face])


def window_around(mask: Mask, room: int) -> Window:
    """Return the rows and columns of a mask's bounding box, with a margin (px)."""
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    return _widened((slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)), room, mask.shape)


def _widened(window: Window, room: int, shape: tuple[int, ...]) -> Window:
    """Return a window with a margin (px) on every side, within a picture (h, w)."""
    of = zip(window, shape, strict=True)
    rows, columns = (slice(max(int(s.start) - room, 0), min(int(s.stop) + room, size)) for s, size in of)
    return rows, columns


def in_window(window: Window) -> tuple[int, int, tuple[int, int]]:
    """Return left, top and (width, height) of a window, as a camera is cropped by."""
    rows, columns = window
    return columns.start, rows.start, (columns.stop - columns.start, rows.stop - rows.start)


def may_show(mesh: Mesh, camera: Camera, camera_from_part: Rigid) -> Mask:
    """Return which faces (F,) may be met by the sights of a camera's pixels; all where its border has none.

    Those are left out that lie wholly beyond a plane through the eye that has all sights, those of the pixels just
    outside the picture too, on its other side. A lens images no sight of an inner pixel beyond those of its border.
    """
    across, down = np.arange(-1.0, camera.width + 1), np.arange(-1.0, camera.height + 1)
    border = [np.stack(np.broadcast_arrays(across, y), axis=-1) for y in (down[0], down[-1])]
    border += [np.stack(np.broadcast_arrays(x, down), axis=-1) for x in (across[0], across[-1])]
    d = camera.unproject(np.concatenate(border))
    if not (d[:, 2] > 0).all():  # NaN too: beyond what the lens images, or what a plane does
        return np.ones(mesh.n_faces, bool)
    u = d[:, :2] / d[:, 2:]
    (left, top), (right, bottom) = u.min(axis=0), u.max(axis=0)
    planes = np.array([(-1, 0, left), (1, 0, -right), (0, -1, top), (0, 1, -bottom)])  # positive beyond them
    normal, offset = planes @ camera_from_part.rotation, planes @ camera_from_part.translation
    beyond = np.einsum("vi,pi->vp", mesh.vertices, normal) + offset > 0  # BLAS would wake, and wait for, all cores
    code = np.packbits(beyond, axis=1).ravel()  # of a vertex, a bit for each plane
    a, b, c = mesh.faces.T
    return np.asarray(code[a] & code[b] & code[c] == 0)


def _patches(corners: Ids, surface: Longs, part: Ids) -> Longs:
    """Return the patch (n,) of each of some faces, by their corners (n, 3): those of one surface that share corners."""
    _, which = np.unique(surface * (int(part.max(initial=0)) + 1) + part, return_inverse=True)
    place = which.reshape(-1, 1) * (int(corners.max(initial=0)) + 1) + corners  # a corner on two surfaces is two
    node = np.unique(place, return_inverse=True)[1].reshape(-1, 3)
    patch = components(node[:, [0, 1, 0, 2]].reshape(-1, 2), int(node.max(initial=-1)) + 1)
    return np.asarray(patch[node[:, 0]], np.int64)


def _towards(mesh: Mesh, faces: Longs, eye: Array) -> Array:
    """Return the unit normals (n, 3) of faces, turned towards the eye (3,)."""
    a, b, c = (mesh.vertices[mesh.faces[faces, i]] for i in range(3))
    cross = np.cross(b - a, c - a)
    cross /= np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    return np.asarray(np.where(np.einsum("ni,ni->n", cross, eye - a) < 0, -1.0, 1.0)[:, None] * cross)
