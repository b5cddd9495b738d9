"""Checks before a hand-eye calibration: whether robot and camera poses belong together and determine the result.

Each check states its evidence in numbers and what to do. Order: rotation angles between poses (which do not depend on
the direction, the unit or the camera's place), the directions that the motions leave undetermined, direction, unit,
single poses. All work on `HandEyePoses`, in the names of `cadcam.fit.hand_eye`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Longs
from cadcam.errors import DegenerateMotions, InconsistentPoses
from cadcam.fit import hand_eye
from cadcam.fit.hand_eye import motions
from cadcam.fit.hand_eye_poses import HandEyePoses, PosesFit, adjust_robustly
from cadcam.fit.screw import angles_and_slides, freedom, line_of
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

_STRANGERS = np.radians(3.0)  # median difference of rotation angles above which two lists do not belong together
_ANSWERS = 0.005  # weakest response of motions that determine everything: 0.3 deg between the axes
_ANSWERS_NOISE = 5.0  # the same in units of the noise of a pair
_ANSWERS_MOST = 0.1  # responses of this size are no reason to reject, however large the noise
_BETTER = 4.0  # ratio by which another reading of the poses must fit better to be named
_UNITS = {1000.0: "m against mm", 100.0: "m against cm", 10.0: "cm against mm", 25.4: "inches against mm"}
_UNIT_TOLERANCE = 0.15
_SIGMA_OF_MEDIAN = 1.4826 / np.sqrt(2)  # of one pose, from the median difference of a pair
_GROSS = 12.0  # robust sigmas beyond which a pose is a blunder, not noise


@dataclass(frozen=True, slots=True)
class Words:
    """The arrangement, for messages: what the flange holds, what is fixed, and the other mounting's name."""

    held: str
    fixed: str
    other_mounting: str


WORDS = {
    "eye-in-hand": Words("camera", "target", "eye-to-hand"),
    "eye-to-hand": Words("target", "camera", "eye-in-hand"),
}


@dataclass(frozen=True, slots=True, eq=False)
class PoseNoise:
    """How precisely one pose is known, robot and camera together: rotation (rad), position (mm), by medians."""

    rotation: float
    translation: float = 0.0


def refuse_inconsistent(poses: HandEyePoses, mounting: str, names: Sequence[str]) -> Rigid:
    """Return flange_from_held in closed form; raise if robot and camera contradict each other or are degenerate.

    `InconsistentPoses`: order, direction, unit, single poses. `DegenerateMotions`: undetermined directions.
    """
    refuse_strangers(poses, names)
    turning = PoseNoise(_SIGMA_OF_MEDIAN * float(np.median(_angle_differences(poses))))
    refuse_degenerate(poses, mounting, turning)
    noise = PoseNoise(turning.rotation, refuse_wrong_direction(poses, mounting))
    refuse_degenerate(poses, mounting, noise)
    start = hand_eye.park_martin(*motions(poses.base_from_flange, poses.held_from_fixed))
    refuse_gross_errors(poses, names, WORDS[mounting], start, noise)
    return start


def refuse_strangers(poses: HandEyePoses, names: Sequence[str]) -> None:
    """Raise `InconsistentPoses` if most rotation angles between poses differ; a list shifted by some lines is named."""
    differ = _angle_differences(poses)
    median = float(np.median(differ))
    if median <= _STRANGERS:
        return
    n = len(names)
    for how, other in _orders(n).items():
        inside = (other >= 0) & (other < n)
        moved = HandEyePoses(
            poses.base_from_flange[other[inside]],
            poses.held_from_fixed[inside],
            poses.covariance[inside],
        )
        if float(np.median(_angle_differences(moved))) < min(median / _BETTER, _STRANGERS):
            raise InconsistentPoses(
                f"robot poses and pictures are paired wrongly: the angles that robot and camera turned between two "
                f"poses differ by {np.degrees(median):.3g} deg (median), but by "
                f"{np.degrees(np.median(_angle_differences(moved))):.2g} deg with the robot's poses {how}; pair them "
                "by name, or put one list right"
            )
    raise InconsistentPoses(
        f"robot poses and pictures do not belong together: the angles that robot and camera turned between two poses "
        f"differ by {np.degrees(median):.3g} deg (median of {len(differ)} pairs), whatever frames they are given in; "
        "is the robot's rotation convention right (order of angles, degrees, w of the quaternion first or last), and "
        "is every picture with its own pose?"
    )


def _orders(n: int) -> dict[str, Longs]:
    """Return the orders that lists are likely to have by mistake, as rows of the robot's poses (beyond them: none)."""
    rows = np.arange(n)
    orders = {"in reversed order": rows[::-1]}
    for k in range(1, min(n - 3, 10)):
        lines = f"by {k} line{'s' * (k > 1)}"
        orders |= {f"moved down {lines}": rows - k, f"moved up {lines}": rows + k}
    return orders


def refuse_degenerate(poses: HandEyePoses, mounting: str, noise: PoseNoise) -> None:
    """Raise `DegenerateMotions` naming the directions that these motions, or their noise, leave undetermined."""
    A, _ = motions(poses.base_from_flange, poses.held_from_fixed)
    length = max(float(np.median(np.linalg.norm(poses.held_from_fixed.translation, axis=1))), 1e-6)
    heard = _ANSWERS_NOISE * 2 * float(np.hypot(noise.rotation, noise.translation / length))
    floor = float(np.clip(heard, _ANSWERS, _ANSWERS_MOST))
    open_ = freedom(A, length=length, floor=floor)
    if not open_.any:
        return
    slides, turns = open_.slides, open_.turns
    words = WORDS[mounting]
    turned, _ = angles_and_slides(A)
    count = len(slides) + len(turns)
    raise DegenerateMotions(
        f"the robot's motions do not determine where the {words.held} sits on the flange: free "
        f"{'are' if count > 1 or len(slides) == 3 else 'is'} {_free(slides, turns, words.held)}"
        f"{_free_in_base(poses, slides, mounting)}. Evidence: the {len(turned)} motions between "
        f"{len(poses.covariance)} poses turn by up to {np.degrees(turned.max()):.3g} deg, {_axes(A)}; a change of that "
        f"kind moves what is seen by {open_.strength:.2g} of itself, less than the {floor:.2g} that noise can feign. "
        f"{_remedy(slides)}",
        tuple(map(tuple, slides.tolist())),
        tuple(map(tuple, turns.tolist())),
    )


def refuse_wrong_direction(poses: HandEyePoses, mounting: str) -> float:
    """Raise `InconsistentPoses` if inverted robot poses or another unit explain the observations and these do not.

    Otherwise return the noise of one position, mm.
    """
    given, inverted = reading(poses), reading(_inverted(poses))
    words = WORDS[mounting]
    contradict = f"the robot's poses contradict an {mounting} camera: the best placement leaves {given.text}"
    turned = given.rotation > max(np.radians(1.0), _BETTER * inverted.rotation)
    if turned and given.translation < _BETTER * inverted.translation:
        raise InconsistentPoses(
            f"{contradict}; inverted, their rotations would fit ({np.degrees(inverted.rotation):.2g} deg) but not "
            "their positions. Is the convention right: w first or last in the quaternions, angles in the other "
            "order (KUKA's A B C against Fanuc's W P R), matrices transposed?"
        )
    if given.misfit > _BETTER * inverted.misfit:
        raise InconsistentPoses(
            f"{contradict}; inverted they leave {inverted.text}. Either they are flange_from_base and not "
            f"base_from_flange (invert them), or the mounting is {words.other_mounting}{_unit_too(inverted.scale)}"
        )
    unit = _unit(given.scale)
    if unit and given.unscaled > _BETTER * given.translation:
        raise InconsistentPoses(
            f"robot and camera do not measure in one unit: the robot's lengths are {given.scale:.4g} times those of "
            f"the target's coordinates ({unit}). Give both in mm: state the unit of the robot's poses, or that of the "
            f"target's points (with one unit they fit to {given.text})"
        )
    return float(_SIGMA_OF_MEDIAN * given.translation)


def refuse_gross_errors(
    poses: HandEyePoses, names: Sequence[str], words: Words, start: Rigid, noise: PoseNoise
) -> None:
    """Raise `InconsistentPoses` naming single poses that all others contradict."""
    sigma = np.maximum([noise.translation, noise.rotation], [1e-3, 1e-6])
    fixed = hand_eye.fixed_in_base(poses.base_from_flange, start, poses.held_from_fixed)
    fit = adjust_robustly(poses, start, fixed, sigma)
    distance = np.sqrt(fit.squared_distances)
    bad = np.flatnonzero(distance > _GROSS * np.sqrt(6))
    if not bad.size or bad.size > (len(names) - 3) / 2:
        return
    e = fit.offsets
    listed = [
        f"{names[i]!r} ({np.linalg.norm(e[i, :3]):.3g} mm, {np.degrees(np.linalg.norm(e[i, 3:])):.3g} deg off)"
        for i in bad[:8]
    ]
    shift, turn = (np.sqrt(fit.variances) * [1.0, np.degrees(1)]).tolist()
    flips = [i for i in bad.tolist() if _turned_on_the_spot(poses, fit, words, i)]
    flip = (
        f"; for {', '.join(repr(names[i]) for i in flips[:8])} the target is where it should be and only turned, as "
        "when a flat target's second pose was taken for the first"
        if flips
        else ""
    )
    raise InconsistentPoses(
        f"{len(bad)} of {len(names)} poses contradict all others, which agree to {shift:.2g} mm and {turn:.2g} deg: "
        f"{', '.join(listed)}{flip}. Was the robot still moving, or is the picture another pose's? Correct them or "
        f"leave them out"
    )


def consistent_choice(base_from_flange: Rigid, candidates: Rigid, costs: Array, dof: Array) -> Longs:
    """Return which (n,) of two camera poses (n, 2) fits the robot: 0, or 1 where a flat target's second fits better.

    candidates: poses (n, 2) of either direction. costs (n, 2): sums of squares of pixels; a second pose that fits its
    picture worse than chi-square with `dof` (n,) allows is not considered.
    """
    n = len(costs)
    open_ = np.isfinite(costs[:, 1]) & (costs[:, 1] < costs[:, 0] * _ratio_allowed(dof) + 1e-12)
    R = candidates.rotation
    i, j = np.triu_indices(n, 1)
    robot = np.zeros((n, n))
    robot[i, j] = robot[j, i] = _angle(base_from_flange.rotation[i], base_from_flange.rotation[j])
    which = np.zeros(n, dtype=int)
    for _ in range(10):
        now = R[np.arange(n), which]
        differ = np.abs(_angle(R[:, :, None], now[None, None]) - robot[:, None, :])  # (n, 2, n)
        differ[np.arange(n), :, np.arange(n)] = np.nan
        score = np.nanmedian(differ, axis=2)
        better = np.where(open_ & (score[:, 1] < 0.5 * score[:, 0]), 1, 0)
        if (better == which).all():
            break
        worst = int(np.argmax(np.where(better != which, np.abs(score[:, 0] - score[:, 1]), -1.0)))
        which[worst] = better[worst]  # one at a time: each change updates the medians of the others
    return which


def _ratio_allowed(dof: Array) -> Array:
    """How many times the best sum of squares a second minimum may have: generous, since the robot decides."""
    return np.asarray(1 + 60 / np.maximum(dof, 1))


def _angle(R: Array, S: Array) -> Array:
    """Angle of R^T S, (...)."""
    trace = np.einsum("...ij,...ij->...", R, S)
    return np.asarray(np.arccos(np.clip((trace - 1) / 2, -1, 1)))


def _angle_differences(poses: HandEyePoses) -> Array:
    A, B = motions(poses.base_from_flange, poses.held_from_fixed)
    return np.abs(angles_and_slides(A)[0] - angles_and_slides(B)[0])


@dataclass(frozen=True, slots=True, eq=False)
class ReadingFit:
    """How well one reading of the poses fits: medians over motions of the residual rotation (rad) and translation (mm).

    translation: with the best-fitting scale of the camera's lengths; unscaled: without.
    """

    rotation: float
    translation: float
    scale: float
    unscaled: float

    @property
    def misfit(self) -> float:
        """Return one number by which readings are compared."""
        return (self.rotation + 1e-5) * (self.translation + 1e-3)

    @property
    def text(self) -> str:
        """Return both medians in words."""
        return f"{np.degrees(self.rotation):.2g} deg and {self.translation:.2g} mm (medians)"


def reading(poses: HandEyePoses) -> ReadingFit:
    """Fit rotation, translation and a scale of the camera's lengths to all motions."""
    A, B = motions(poses.base_from_flange, poses.held_from_fixed)
    found = [_reading(A, B, turned) for turned in hand_eye.rotations(A, B, np.ones(len(A.rotation)))]
    return min(found, key=lambda one: one.misfit)


def _reading(A: Rigid, B: Rigid, turned: hand_eye.Turned) -> ReadingFit:
    t_B = B.translation @ turned.R.T
    M = np.concatenate([A.rotation - np.eye(3), -t_B[..., None]], axis=-1).reshape(-1, 4)
    M[:, 3] /= (column := max(float(np.linalg.norm(M[:, 3])), 1e-300))
    scaled, unscaled = _solved(M, -A.translation), _solved(M[:, :3], t_B - A.translation)
    return ReadingFit(float(np.median(turned.left)), scaled[1], float(scaled[0][3] / column), unscaled[1])


def _solved(M: Array, right: Array) -> tuple[Array, float]:
    """Return the least-squares solution and the median length of the residuals of the motions (m, 3)."""
    x, *_ = np.linalg.lstsq(M, right.ravel(), rcond=1e-12)
    return np.asarray(x), float(np.median(np.linalg.norm((M @ x - right.ravel()).reshape(-1, 3), axis=1)))


def _inverted(poses: HandEyePoses) -> HandEyePoses:
    return HandEyePoses(poses.base_from_flange.inv, poses.held_from_fixed, poses.covariance)


def _unit(scale: float) -> str:
    """Name the pair of units whose ratio is near a scale; "" if it is 1 or none."""
    for ratio, name in _UNITS.items():
        for value in (ratio, 1 / ratio):
            if abs(scale / value - 1) < _UNIT_TOLERANCE:
                return name
    return ""


def _unit_too(scale: float) -> str:
    unit = _unit(scale)
    return f"; and the lengths differ by a factor of {scale:.4g}: {unit}" if unit else ""


def _turned_on_the_spot(poses: HandEyePoses, fit: PosesFit, words: Words, i: int) -> bool:
    """Return whether the target of one pose has the right position but is rotated."""
    should = fit.flange_from_held.inv @ poses.base_from_flange[[i]].inv @ fit.base_from_fixed
    seen = poses.held_from_fixed[[i]]
    if words.held == "target":
        should, seen = should.inv, seen.inv
    between = should.inv @ seen
    (turn,), (slide,) = angles_and_slides(between)
    point, _ = line_of(between.log()[0])
    distance = float(np.linalg.norm(seen.translation))
    return bool(np.radians(1) < turn < np.radians(100) and abs(slide) < 0.01 * distance > 0.03 * np.linalg.norm(point))


def _free(slides: Array, turns: Array, held: str) -> str:
    parts = []
    if len(slides) == 3:
        parts.append(f"the {held}'s whole position (x, y and z)")
    elif len(slides) == 2:
        parts.append(
            f"the {held}'s position in the plane of {_direction(slides[0])} and {_direction(slides[1])} of the flange"
        )
    elif len(slides) == 1:
        parts.append(f"the {held}'s position along {_direction(slides[0])} of the flange")
    if len(turns) == 3:
        parts.append("its whole rotation")
    else:
        for turn in turns:
            point, direction = line_of(turn)
            through = "" if len(slides) == 3 else f", rotation and position together, through {_vector(point, 1)} mm"
            parts.append(f"its turn about {_direction(direction)} of the flange{through}")
    return ", and ".join(parts)


def _free_in_base(poses: HandEyePoses, slides: Array, mounting: str) -> str:
    """Describe how an eye-to-hand camera may slide in the base: together with what the flange holds."""
    if mounting != "eye-to-hand" or len(slides) != 1:
        return ""
    in_base = poses.base_from_flange.rotation[0] @ slides[0]
    return f" (and with it the camera's position along {_direction(in_base)} of the base)"


def _axes(A: Rigid) -> str:
    """Describe the axes of the larger rotations."""
    w = so3.log(A.rotation)
    angle = np.linalg.norm(w, axis=1)
    large = angle > max(0.2 * angle.max(), np.radians(0.5))
    if not large.any():
        return "that is not at all"
    n = w[large] / angle[large, None]
    _, _, Vt = np.linalg.svd(n, full_matrices=False)
    along = np.degrees(np.arccos(np.clip(np.abs(n @ Vt[0]), 0, 1)))
    return f"about axes within {along.max():.2g} deg of {_direction(Vt[0])} of the flange"


def _direction(v: Array) -> str:
    """Return a direction as text, with the sign that makes its largest component positive."""
    return _vector(v * np.sign(v[np.argmax(np.abs(v))]), 3)


def _vector(v: Array, decimals: int) -> str:
    return "(" + ", ".join(f"{x + 0.0:.{decimals}f}" for x in np.round(v, decimals)) + ")"


def _remedy(slides: Array) -> str:
    if len(slides) == 3:
        return "Add poses that turn the flange by 30 deg or more, about at least two different axes"
    return "Add poses that tilt the flange by 20 to 40 deg about other axes than this one"
