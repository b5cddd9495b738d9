"""What a part's faces show that its model lacks, print, grain or dirt: learned from frames, followed in later ones.

Where the part was found, patches of the photos are taken off its faces: a keyframe. Later frames are aligned with the
keyframe that was seen most alike (`locate.track.patches`). That tells how the part moved since to a small part of what
edges tell, but not where it was then. So it is evidence beside the edges of each frame, and these hold it where it is
(L. Vacchetti, V. Lepetit, P. Fua, "Stable real-time 3D tracking using online and offline information", PAMI 26, 2004).

A keyframe's pose is mended by what the edges of each frame that follows it say, and counts as so many frames' edges, up
to `_FRAMES`: what they err by at random averages out, what changes with the view is forgotten. What they err by in all
frames alike does not average out, so the stated covariance does not shrink with the frames (as in
`locate.track.motion`). All of it follows from the frames' photos and the poses that were found, so a run that was cut
off can go through them again and be as if there had been no break.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.geometry.rigid import Rigid
from cadcam.locate.evidence import PoseEvidence
from cadcam.locate.freedom import Freedom
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.track.patches import LEAST, Canvas, Patches, aligned
from cadcam.render.view import Renderer

_TURN, _SCALE = math.radians(12.0), 0.12  # by which a view differs from its keyframe's before one more is learned
_KEPT = 12  # keyframes
_PATIENCE = 2  # frames in which none is found again, after which all are given up
_MEMORY, _DENIED = 0.8, 25.0  # of how edges pull, from frame to frame; chi^2 of six parameters that denies the print
_FRAMES = 4.0  # that a keyframe counts as at most
_NEVER_FREE = 1e-9  # share of the largest variance below which a direction is not free


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """Where a keyframe's patches are in a frame, as evidence of the pose, and how many of them were found again.

    number: of the keyframe. by_one_frame (6, 6): covariance of its pose by the edges of one; alone (6, 6): of the
    alignment.
    """

    evidence: PoseEvidence
    number: int
    by_one_frame: Array
    alone: Array
    found: int

    def fused(self, fitted: Array) -> Array:
        """Return the covariance (6, 6) of a pose fitted to this and to edges, `fitted` were they independent.

        They are not: what a frame's edges err by, the keyframe's erred by too. So errors are e = R^(1/2) u with one u,
        (I - K) of it from the keyframe and K from the frame's own edges, whose share K is.
        """
        scale = np.repeat([1.0, self.evidence.radius], 3)
        C, R, S, P = (
            scale[:, None] * A * scale for A in (fitted, self.by_one_frame, self.alone, self.evidence.covariance)
        )
        by_edges = _root(_inverse(C) - _inverse(P))
        left = np.eye(6) - C @ by_edges @ by_edges
        E = left @ _root(R) + C @ by_edges
        return np.asarray((E @ E.T + left @ S @ left.T) / scale[:, None] / scale)


@dataclass(frozen=True, slots=True, eq=False)
class _Keyframe:
    """Patches of each photo, what the photos were seen from, and where: camera_from_part.

    off: by which later frames mended the pose; by_one_frame (6, 6): its covariance by one frame's edges; frames: how
    many of them the pose counts as.
    """

    patches: tuple[Patches, ...]
    views: tuple[Rigid, ...]
    off: Rigid
    by_one_frame: Array
    frames: float

    @property
    def covariance(self) -> Array:
        """Return the covariance (6, 6) that it is weighed by."""
        return self.by_one_frame / self.frames


class Texture:
    """The keyframes of a part that is followed."""

    def __init__(self, part: Part) -> None:
        self._scene = part.scene
        low, high = part.scene.mesh.bounds
        self._corners = np.where(np.indices((2, 2, 2)).reshape(3, -1).T, high, low)
        self._middle, self._radius = (low + high) / 2, float(np.linalg.norm(high - low) / 2)
        self._renderer: Renderer | None = None
        self.forget()

    def forget(self) -> None:
        """Start anew, as after a loss."""
        self._keyframes: list[_Keyframe] = []
        self._misses = 0
        self._pull, self._pulls = np.zeros(6), 0.0

    def follow(self, photos: Sequence[Photo], start: Rigid, freedom: Freedom) -> Followed | None:
        """Return where print puts the part, from a start some px off; None where the print is not found again."""
        if not self._keyframes:
            return None
        views = _views(photos, start)
        number = int(np.argmin([self._difference(k.views, views) for k in self._keyframes]))
        keyframe = self._keyframes[number]
        found = aligned(keyframe.patches, self._canvases(photos, views), photos, start, freedom)
        if found is None:
            return None
        pose, covariance = found.world_from_part @ keyframe.off, keyframe.covariance + found.covariance
        evidence = PoseEvidence(pose, covariance, self._radius)
        return Followed(evidence, number, keyframe.by_one_frame, found.covariance, found.found)

    def keep(self, photos: Sequence[Photo], pose: PoseEstimate, followed: Followed | None) -> None:
        """Take up where a frame showed the part, and by which keyframe that was followed, if by any."""
        if followed is None:
            self._misses += 1
            if not self._keyframes or self._misses > _PATIENCE:
                self.forget()
                self._learn(photos, pose, 1.0)
            return
        self._misses = 0
        if self._slides(followed, pose):
            self.forget()
            self._learn(photos, pose, 1.0)
            return
        mended = self._mended(self._keyframes[followed.number], followed, pose)
        self._keyframes[followed.number] = mended
        if self._difference(mended.views, _views(photos, pose.world_from_part)) > 1.0:
            self._learn(photos, pose, mended.frames)

    def _slides(self, followed: Followed, pose: PoseEstimate) -> bool:
        """Return whether edges keep pulling the pose away to one side, as where print slides over a part."""
        there, scale = followed.evidence, np.repeat([1.0, self._radius], 3)
        off = scale * (there.world_from_part.inv @ pose.world_from_part).log()
        sigmas = _root(_inverse(scale[:, None] * there.covariance * scale)) @ off
        self._pull, self._pulls = _MEMORY * self._pull + sigmas, _MEMORY**2 * self._pulls + 1
        return bool(self._pull @ self._pull > _DENIED * self._pulls)

    def _mended(self, keyframe: _Keyframe, followed: Followed, pose: PoseEstimate) -> _Keyframe:
        """Return the keyframe moved by its share of what edges moved the pose by."""
        scale = np.repeat([1.0, self._radius], 3)
        own, whole = (scale[:, None] * A * scale for A in (keyframe.covariance, followed.evidence.covariance))
        moved = (followed.evidence.world_from_part.inv @ pose.world_from_part).log()
        off = keyframe.off @ Rigid.exp(own @ _inverse(whole) @ (scale * moved) / scale)
        frames = min(keyframe.frames + 1, _FRAMES)
        by_one_frame = keyframe.by_one_frame + (pose.from_noise - keyframe.by_one_frame) / frames
        return replace(keyframe, off=off, by_one_frame=by_one_frame, frames=frames)

    def _learn(self, photos: Sequence[Photo], pose: PoseEstimate, frames: float) -> None:
        views = _views(photos, pose.world_from_part)
        patches = tuple(
            self._patches(canvas, view) for canvas, view in zip(self._canvases(photos, views), views, strict=True)
        )
        if sum(len(one) for one in patches) >= LEAST:
            self._keyframes.append(_Keyframe(patches, tuple(views), Rigid(), pose.from_noise, frames))
            del self._keyframes[:-_KEPT]

    def _patches(self, canvas: Canvas | None, camera_from_part: Rigid) -> Patches:
        from cadcam.render import open_renderer

        if canvas is None:
            return Patches.none()
        if self._renderer is None:
            self._renderer = open_renderer(self._scene, threads=1)
        return Patches.learned(self._renderer, canvas, camera_from_part)

    def _canvases(self, photos: Sequence[Photo], views: Sequence[Rigid]) -> list[Canvas | None]:
        return [Canvas.of(photo, self._corners, view) for photo, view in zip(photos, views, strict=True)]

    def _difference(self, one: Sequence[Rigid], other: Sequence[Rigid]) -> float:
        """Return how differently photos show the part, from 1 on worth a keyframe; roll in the picture is ignored."""
        a, b = (np.array([view.origin - self._middle for view in views]) for views in (one, other))
        far = np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)
        turned = np.arccos(np.clip((a * b).sum(axis=1) / (far[0] * far[1]), -1, 1))
        return float(np.maximum(turned / _TURN, np.abs(np.log(far[0] / far[1])) / _SCALE).max())


def _views(photos: Sequence[Photo], world_from_part: Rigid) -> list[Rigid]:
    return [photo.viewpoint.camera_from_world @ world_from_part for photo in photos]


def _inverse(A: Array) -> Array:
    """Return the inverse of a covariance within the directions that are free."""
    return np.asarray(np.linalg.pinv(A, rcond=_NEVER_FREE, hermitian=True))


def _root(A: Array) -> Array:
    """Return the symmetric root; what rounding made negative counts as zero."""
    values, axes = np.linalg.eigh(A)
    return np.asarray((axes * np.sqrt(np.maximum(values, 0.0))) @ axes.T)
