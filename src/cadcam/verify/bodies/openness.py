"""How open the surfaces of a part lie: the bottom of a bore is dark in a light that its mouth is bright in.

The light of a photo is fitted to its surfaces by their normals (`cadcam.locate.quality.light`), as if each saw the
whole sky. A cavity sees little of it. How much of the rest its walls give back depends on their paint and on where the
lamps are: that may be nothing, or all. What is asked of a place is one less its ambient occlusion (S. Zhukov, A. Iones
and G. Kronin, "An ambient light illumination model", Rendering Techniques, 1998).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Ids, Longs
from cadcam.cad.mesh import Mesh
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.render.caster import Caster
from cadcam.verify.edges.shown import Window, in_window, may_show

CAVE = 0.5  # openness below which a surface lies in a cavity
_PLACES, _RAYS = 6, 48  # of a group of pixels that are asked, and directions from each
_OPEN = 0.5  # share of the sky, by cosine, from which a surface is open: in a corner of two walls it sees half
_OFF = 1e-5  # of the model's radius: rays start that far from their surface
_LAYERS = 8  # of a body left out, one behind the other, that a ray passes
_GOLDEN = np.pi * (3 - np.sqrt(5))  # rad between one direction and the next


def dimming(tone: Array, open_: Array) -> tuple[Array, Array]:
    """Return the factor (n,) of tones (n,) that the light predicts for surfaces of an openness (n,), and its variances.

    Of what the sky lacks any share may come back: the mean of these, and their variance.
    """
    return (1 + open_) / 2, (tone * (1 - open_)) ** 2 / 12


@dataclass(frozen=True, slots=True, eq=False)
class Sky:
    """The sky over what a window of a photo may show of a part at a pose, the body `without` left out."""

    mesh: Mesh
    caster: Caster
    photo: Photo
    camera_from_part: Rigid
    without: int = -1

    @classmethod
    def of(cls, part: Part, photo: Photo, world_from_part: Rigid, window: Window) -> Sky:
        """Return the sky over a part in a window of a photo; what lies beside the window takes nothing of it."""
        mesh, camera_from_part = part.scene.mesh, photo.camera_from_world @ world_from_part
        kept = may_show(mesh, photo.camera.crop(*in_window(window)), camera_from_part)
        near = mesh if kept.all() or not kept.any() else mesh.select(kept)
        return cls(near, part.caster if near is mesh else Caster(near), photo, camera_from_part)

    def of_groups(self, q: Array, group: Longs, n: int) -> Array:
        """Return the mean openness (n,) of groups of pixels: q (m, 2) px, group (m,) or -1; 1 for small groups."""
        order = np.argsort(group, kind="stable")
        size = np.bincount(group[group >= 0], minlength=n)
        start = np.cumsum(size) - size + int((group < 0).sum())
        asked = np.flatnonzero(size >= _PLACES)
        among = (np.arange(_PLACES) + 0.5) * size[asked, None] / _PLACES
        out = np.ones(n)
        places = order[start[asked, None] + among.astype(int)]
        out[asked] = self.openness(q[places.ravel()]).reshape(-1, _PLACES).mean(axis=1)
        return out

    def openness(self, q: Array) -> Array:
        """Return how open what shows at places (n, 2) px lies, 0 to 1: for what sees half the sky or is nothing."""
        ray = self.photo.camera.unproject(q) @ self.camera_from_part.rotation
        eye = np.broadcast_to(self.camera_from_part.origin, ray.shape)
        face = self._first(eye, ray)
        out, met = np.ones(len(q)), np.flatnonzero(face >= 0)
        normal = _normals(self.mesh.vertices[self.mesh.faces[face[met]]])
        normal *= -np.sign(np.einsum("ni,ni->n", normal, ray[met]))[:, None]
        p = eye[met] + self._reach(eye[met], ray[met], face[met])[:, None] * ray[met]
        start = np.repeat(p + _OFF * self.caster.radius * normal, _RAYS, axis=0)
        blocked = self._first(start, _over(normal).reshape(-1, 3)) >= 0
        out[met] = np.minimum((1 - blocked.reshape(-1, _RAYS).mean(axis=1)) / _OPEN, 1.0)
        return out

    def _first(self, start: Array, ray: Array) -> Ids:
        """Return the first face (n,) that rays meet, past those of the body left out; -1 if none."""
        caster = self.caster
        at = start + np.maximum(np.linalg.norm(start - caster.center, axis=1) - 2 * caster.radius, 0.0)[:, None] * ray
        through, face = np.arange(len(at)), np.full(len(at), -1, np.int32)
        for _ in range(_LAYERS):
            face[through] = caster.first_hit(at[through], ray[through], np.full(len(through), 6 * caster.radius))
            through = through[(face[through] >= 0) & (self.mesh.part[face[through]] == self.without)]
            if not len(through):
                break
            past = self._reach(at[through], ray[through], face[through]) + _OFF * caster.radius
            at[through] += past[:, None] * ray[through]
        return face

    def _reach(self, start: Array, ray: Array, face: Ids) -> Array:
        """Return how far (n,) mm along rays the planes of the faces that they meet are."""
        corners = self.mesh.vertices[self.mesh.faces[face]]
        normal = _normals(corners)
        steep = np.einsum("ni,ni->n", normal, ray)
        ahead = np.einsum("ni,ni->n", normal, corners[:, 0] - start)
        return np.asarray(ahead / np.where(steep == 0, np.inf, steep))


def _normals(corners: Array) -> Array:
    """Return the unit normals (n, 3) of faces with corners (n, 3, 3)."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), np.finfo(np.float64).tiny))


def _over(normal: Array) -> Array:
    """Return directions (n, rays, 3) over surfaces of normals (n, 3), as dense as the cosine with them."""
    k = np.arange(_RAYS)
    radius, angle = np.sqrt((k + 0.5) / _RAYS), _GOLDEN * k
    aside = np.where(np.abs(normal[:, :1]) < 0.6, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    u = np.cross(normal, aside)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    axes = np.stack([u, np.cross(normal, u), normal], axis=1)
    return np.asarray(np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - radius**2)], axis=1) @ axes)
