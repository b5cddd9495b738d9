"""A part that lies on a known plane: a face and a turn, at a place in a photo, fix its pose.

Poses of a search are laid onto the plane and climb there. What is refined is free; then it must lie there to within its
uncertainty and that of the plane. Of poses that do, the plane tells height and tilts, where it is stated how well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.errors import BadValue
from cadcam.geometry import rotation as so3
from cadcam.geometry.plane import Plane, axes_across
from cadcam.geometry.ray import Ray
from cadcam.geometry.rigid import Rigid, by_twist
from cadcam.locate.freedom import Freedom
from cadcam.locate.location import Location
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.quality.support import SEARCHED
from cadcam.locate.search.climb import Climb, FieldLevel, climbed
from cadcam.locate.uncertainty import weakest_direction
from cadcam.locate.views.resting import OnPlane, few
from cadcam.locate.views.view_range import ViewRange

_STATED_DEG = 5.0  # faces so near to a direction that was stated are meant
_MOST_FACES = 48  # that are searched: of round bodies neighbours are left out
_SAME_FACE = 1.0 - 1e-4  # cosine between a face and the image of another by a symmetry
_SEARCHED = 1  # constraints met in any photo by the best of all poses on a plane, of which three numbers are unknown
_TOLD = 3  # constraints that a free fit meets, but of which the plane tells whether they are right: height and tilts
_SIGMAS = 4.0  # of the height above the plane: what is farther off does not lie on it
_SIGMA, _FLATTEST_MM = 0.5, 0.01  # sd of heights: of what holds practically always; at least
_RAYS = 12  # along each side of a photo, to see whether it shows the plane


@dataclass(frozen=True, slots=True, eq=False)
class Lying:
    """A part on a plane, whose normal points to the cameras: faces that it may lie on, and those that are searched."""

    part: Part
    plane: Plane
    within_mm: float
    stated: bool
    faces: Longs
    searched: Longs

    @classmethod
    def of(cls, part: Part, photos: Sequence[Photo], views: ViewRange) -> Lying | None:
        """Return it for a range of views, None where no plane is known. Raises `BadValue` where no photo shows it."""
        if views.on is None:
            return None
        faces = part.resting.chosen(views.on.down, _STATED_DEG)
        plane = _towards_cameras(views.on, photos)
        return cls(part, plane, views.on.checked_mm, views.on.within_mm is not None, faces, _unlike(part, faces))

    @property
    def freedom(self) -> Freedom:
        """Return the motions on the plane."""
        return Freedom.planar(self.plane.normal)

    @property
    def down(self) -> Array:
        """Return the directions (S, 3) of the part that point to the plane, of the faces that are searched."""
        return self.part.resting.down[self.searched]

    def upright(self) -> Array:
        """Return a rotation (S, 3, 3) world_from_part for each face that is searched."""
        return np.stack([_turn_onto(down[None], -self.plane.normal)[0] for down in self.down])

    def face(self, R: Array) -> Longs:
        """Return which of the searched faces is the lowest at rotations (N, 3, 3)."""
        return np.asarray(np.argmax(-(self.plane.normal @ R) @ self.down.T, axis=1))

    def placed(self, R: Array, face: Longs, sight: Array, eye: Array) -> Array:
        """Return poses (N, 12) with rotations (N, 3, 3), lying, the middle along sights (N, 3) from an eye (3,).

        Not finite where the sight does not go down to the plane.
        """
        middle = self.part.aspects.centre
        above = (self.part.resting.height[self.searched] - self.down @ middle)[face]
        steep = sight @ self.plane.normal
        away = (above - float(self.plane.distance(eye))) / np.where(steep < 0, steep, np.nan)
        there = eye + np.where(away > 0, away, np.nan)[:, None] * sight
        return np.concatenate([R.reshape(-1, 9), there - R @ middle], axis=1)

    def laid(self, poses: Array, eye: Array) -> Array:
        """Return poses (N, 12) laid onto the plane, on their lowest faces, where they are seen from an eye (3,) mm."""
        R, t = poses[:, :9].reshape(-1, 3, 3), poses[:, 9:]
        face = self.face(R)
        turn = _turn_onto((R @ self.down[face][..., None])[..., 0], -self.plane.normal)
        return self.placed(turn @ R, face, R @ self.part.aspects.centre + t - eye, eye)

    def climbed(self, stage: FieldLevel, poses: Array, climb: Climb) -> tuple[Array, Array]:
        """Return poses (N, 12) after climbing at one level on the plane, and their scores (N,)."""
        face = self.face(poses[:, :9].reshape(-1, 3, 3))
        moved, score = poses.copy(), np.zeros(len(poses))
        for k in np.unique(face):
            own = face == k
            moved[own], score[own] = climbed(self.part.aspects, stage, poses[own], self._motions(int(k)), climb)
        return moved, score

    def _motions(self, face: int) -> Array:
        """Return twists (6, 3) of the part on a face: two slides, and the turn about the normal through its middle."""
        down = self.down[face]
        one, other = axes_across(down)
        still = np.zeros(3)
        turn = np.r_[np.cross(self.part.aspects.centre, down), down]
        return np.stack([np.r_[one, still], np.r_[other, still], turn], axis=1)

    def checked(self, location: Location) -> Location:
        """Return a location as not found where it does not lie on the plane, without alternatives that do not."""
        alternatives = tuple(one for one in location.alternatives if not self.off(one.pose))
        location = replace(location, alternatives=alternatives)
        why = self.off(location.pose) if location.found else ""
        return location.uncertain(why, off_plane=True) if why else location

    def counted(self, location: Location, photos: Sequence[Photo]) -> Location:
        """Return a location that was found with the plane counted in its pose, if it is stated how well it is known."""
        if not (self.stated and location.found):
            return location
        alternatives = tuple(replace(one, pose=self.on_it(one.pose)) for one in location.alternatives)
        pose = self.on_it(location.pose)
        known = weakest_direction(pose, self.part.aspects.centre, photos)
        told = location.noting(f"by the plane, known to {self.within_mm:g} mm, as well: {known}")
        return replace(told, pose=pose, alternatives=alternatives)

    def on_it(self, pose: PoseEstimate) -> PoseEstimate:
        """Return a pose that lies on the plane, improved by that, with its covariance.

        The heights of the middle of its face, and of its ends above that along its two axes, are known to half of what
        holds practically always, each by itself. Errors of the cameras do not weigh and remain: where the plane was
        measured with these, it is off by the same errors.
        """
        noise, sigma = pose.determined.from_noise, max(_SIGMA * self.within_mm, _FLATTEST_MM)
        height, J = self._heights(pose.world_from_part)
        gain = np.linalg.solve(J @ noise @ J.T + sigma**2 * np.eye(3), J @ noise).T
        left = np.eye(6) - gain @ J
        improved = left @ noise @ left.T + sigma**2 * gain @ gain.T
        moved = pose.world_from_part @ Rigid.exp(-gain @ height)
        return replace(pose, world_from_part=moved, from_noise=pose.from_noise - noise + improved)

    def _heights(self, world_from_part: Rigid) -> tuple[Array, Array]:
        """Return the height of the lowest face's middle, those of its ends above it (3,), their Jacobian (3, 6)."""
        normal = world_from_part.rotation.T @ self.plane.normal
        corners = self.part.resting.corners[self._face(normal)]
        axes = np.linalg.svd(corners - corners.mean(axis=0))[2][:2]
        least, most = (corners @ axes.T).min(axis=0), (corners @ axes.T).max(axis=0)
        middle = corners[0] + ((least + most) / 2 - axes @ corners[0]) @ axes
        ends = (most - least)[:, None] / 2 * axes
        J = by_twist(np.concatenate([middle[None], ends]), np.broadcast_to(normal, (3, 3)))
        J[1:, :3] = 0.0  # no shift changes differences
        return np.r_[self.plane.distance(world_from_part @ middle), ends @ normal], J

    def _face(self, normal: Array) -> int:
        """Return the number of the face that looks most against the plane's normal (3,), in the part frame."""
        return int(self.faces[np.argmax(self.part.resting.down[self.faces] @ -normal)])

    def off(self, pose: PoseEstimate) -> str:
        """Return in words how a pose does not lie on the plane; empty where it lies there."""
        told, resting = pose.determined, self.part.resting
        R = told.world_from_part.rotation
        normal = R.T @ self.plane.normal  # in the part frame
        face = self._face(normal)
        p = resting.corners[face]
        height = self.plane.distance(told.world_from_part @ p)
        J = np.concatenate([np.broadcast_to(normal, p.shape), np.cross(p, normal)], axis=1)
        sd = np.sqrt(np.einsum("ni,ij,nj->n", J, told.covariance, J).clip(min=0.0))
        beyond = np.abs(height) - self.within_mm - _SIGMAS * sd
        k = int(np.argmax(beyond))
        if beyond[k] <= 0:
            return ""
        tilt = np.degrees(
            np.arctan2(np.linalg.norm(np.cross(resting.down[face], normal)), -resting.down[face] @ normal)
        )
        side = "above" if height[k] > 0 else "below"
        return (
            f"it does not lie on the plane: the face next to it is tilted by {tilt:.1f} deg and up to"
            f" {abs(height[k]):.2g} mm {side} it (uncertainty {sd[k]:.2g} mm, plane {self.within_mm:g} mm)"
        )


def met_by_search(lying: Lying | None) -> int:
    """Return how many constraints a pose meets because it is the best of a search without a start.

    On a plane, less those met by its free fit that are evidence all the same: a wrong pose would not lie there. Turns
    of the part that no photo shows are not fitted.
    """
    return SEARCHED if lying is None else _SEARCHED - max(_TOLD - lying.part.spins.shape[1], 0)


def _turn_onto(directions: Array, there: Array) -> Array:
    """Return the least rotations (N, 3, 3) that take unit directions (N, 3) onto another (3,)."""
    axis = np.cross(directions, there)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    aside = np.stack(axes_across(directions))[0]
    axis = np.where(sine > 1e-12, axis / np.maximum(sine, 1e-300), aside)
    return so3.exp(axis * np.arctan2(sine, (directions @ there)[:, None]))


def _unlike(part: Part, faces: Longs) -> Longs:
    """Return those of the faces on which the part looks different, of round bodies not all neighbours."""
    resting, kept = part.resting, list[int]()
    if part.spins.shape[1] == 3:  # a ball
        return faces[:1]
    middle = resting.height - resting.down @ part.aspects.centre
    for k in faces.tolist():
        images = np.stack([S.rotation @ resting.down[k] for S in part.symmetries])
        alike = (resting.down[kept] @ images.T > _SAME_FACE).any(axis=1)
        if not (alike & (np.abs(middle[kept] - middle[k]) < (1 - _SAME_FACE) * part.aspects.radius)).any():
            kept.append(k)
    every = np.array(kept, np.int64)
    return every[few(resting.down[every], _MOST_FACES)]


def _towards_cameras(on: OnPlane, photos: Sequence[Photo]) -> Plane:
    """Return the plane with its normal towards the cameras. Raises `BadValue` where no photo shows it."""
    plane = on.plane
    above = np.array([float(plane.distance(photo.camera_from_world.origin)) for photo in photos])
    if above.min() * above.max() <= 0:
        raise BadValue("plane that the part lies on", f"{on.named}, not below all cameras", "one with them on one side")
    if not any(_shows(photo, plane).any() for photo in photos):
        wanted = "one in view, in the frame of the world that the cameras' poses are in"
        raise BadValue("plane that the part lies on", f"{on.named}, where no photo shows it", wanted)
    return Plane(np.sign(above[0]) * plane.normal, np.sign(above[0]) * plane.offset)


def _shows(photo: Photo, plane: Plane) -> Mask:
    """Return at which of some places in a photo the plane is seen."""
    x, y = (np.linspace(0, side - 1, _RAYS) for side in photo.camera.size)
    sight = photo.camera.unproject(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    sight = sight[np.isfinite(sight).all(axis=1)] @ photo.camera_from_world.rotation
    origin = np.broadcast_to(photo.camera_from_world.origin, sight.shape)
    return np.asarray(np.isfinite(plane.meet(Ray(origin, sight))).all(axis=1))
