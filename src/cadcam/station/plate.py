"""The calibration plate: where its marks are, and where the plate lies once some of its points were surveyed.

A plate carries marks for the camera and reflectors for the surveying instrument (theodolites, a laser tracker), all
known in the plate's own axes. Its placement is a rotation and a translation of the plane, with the scale fixed, so that
the marks are known better than the survey of a single reflector.
Source: "Industrial Vision" (1997), section 6.4.3.4, EQ 6.12.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np

from cadcam.arrays import Array, Brief, Floats, frozen
from cadcam.errors import BadValue, DegenerateGeometry, TooFewPoints
from cadcam.kinds import expect, expect_names, expect_numbers, expect_positive

_MOST_ORDERS = 6  # reflectors of which all orders are tried, to name a wrong one
_UNITS_APART = 100.0  # ratio of the sizes by marks and by reflectors: m and mm are a thousand apart, no plate is
_GROSS = 5.0  # residual in units of the stated noise beyond which the survey is not of this plate

# Industrial Vision, Tables 6.7 and 6.8; the reflectors' places follow from Table 6.5
_B4_MARKS = ((0, 0), (0, 280), (460, 280), (460, 0), (260, 0), (130, 140), (260, 280), (360, 140))
_B4_MARK = "dot-ring:40mm:80mm:120mm"  # the outer diameter is the thesis' (6.3.3); the others are not stated there
_B4_REFLECTORS = ((160, 0), (0, 140), (160, 280), (460, 140))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Plate(Brief):
    """Marks (K, 2) and reflectors (M, 2) in the plate's axes, mm, x to y counter-clockwise as in the world.

    sigma_mm: standard deviation of each coordinate of each point. mark: the marks' pattern, as read by
    `target.marks.mark.parse_mark`; empty where it is not stated.
    """

    marks: Array
    reflectors: Array
    mark_names: tuple[str, ...] = ()
    reflector_names: tuple[str, ...] = ()
    sigma_mm: float = 0.0
    mark: str = ""

    def __post_init__(self) -> None:
        expect_numbers(self)
        for what in ("mark", "reflector"):
            points = frozen(getattr(self, f"{what}s"), f"{what}s of the plate", (None, 2))
            named = expect_names(getattr(self, f"{what}_names"), f"{what}_names")
            names = named or tuple(str(i + 1) for i in range(len(points)))
            if len(names) != len(points) or len(set(names)) != len(names):
                raise BadValue(f"{what} names", names, f"a different name for each of {len(points)} {what}s")
            object.__setattr__(self, f"{what}s", points)
            object.__setattr__(self, f"{what}_names", names)
        expect_positive(self.sigma_mm, "sigma_mm of the plate", "a number from 0 on", zero=True)
        self._refuse_two_units()

    def _refuse_two_units(self) -> None:
        if not (len(self.marks) and len(self.reflectors)):
            return
        marks, reflectors = (float(np.linalg.norm(np.ptp(p, axis=0))) for p in (self.marks, self.reflectors))
        if min(marks, reflectors) * _UNITS_APART < max(marks, reflectors) and min(marks, reflectors) > 0:
            raise BadValue(
                "size of the plate",
                f"{marks:g} mm by its marks, {reflectors:g} mm by its reflectors",
                "both in mm: one of them seems to be in another unit",
            )

    @classmethod
    def b4(cls, *, sigma_mm: float = 0.2) -> Plate:
        """Return the plate of the thesis: eight templates of 120 mm and four reflectors a to d on 460 x 280 mm."""
        marks, reflectors = np.array(_B4_MARKS, dtype=np.float64), np.array(_B4_REFLECTORS, dtype=np.float64)
        return cls(marks, reflectors, reflector_names=("a", "b", "c", "d"), sigma_mm=sigma_mm, mark=_B4_MARK)

    @property
    def key(self) -> bytes:
        """Return a key that is equal for plates read from two files that are the same plate."""
        return self.points.tobytes() + np.float64(self.sigma_mm).tobytes()

    @property
    def points(self) -> Array:
        """Return marks and reflectors (K + M, 2), in this order: the points that `sigma_mm` refers to."""
        return np.concatenate([self.marks, self.reflectors])


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Placement(Brief):
    """Where a plate lies: p = R(angle) local + shift, from its surveyed reflectors (M, 2) mm.

    gain (3, 2 M): derivative of (shift x, shift y, angle) by the surveyed coordinates. sigma_mm: of one of those.
    dof: degrees of freedom behind sigma_mm, inf where it was stated.
    """

    plate: Plate
    surveyed: Array
    shift: Array
    angle: float
    gain: Array
    sigma_mm: float
    dof: float = np.inf

    @property
    def rotation(self) -> Array:
        """Return R (2, 2)."""
        return turn(self.angle)

    @property
    def marks(self) -> Array:
        """Return where the marks are in the world (K, 2) mm (Table 6.8)."""
        return self.at(self.plate.marks)

    @property
    def residuals(self) -> Array:
        """Return surveyed minus fitted reflectors (M, 2) mm (Table 6.7)."""
        return np.asarray(self.surveyed - self.at(self.plate.reflectors))

    @property
    def rms(self) -> float:
        """Return the root mean square distance of the reflectors, mm (EQ 6.12)."""
        return float(np.sqrt(np.mean(np.sum(self.residuals**2, axis=1))))

    @property
    def covariance(self) -> Array:
        """Return the covariance (3, 3) of (shift x, shift y, angle), mm and rad, from the survey alone."""
        return np.asarray(self.sigma_mm**2 * self.gain @ self.gain.T)

    def at(self, local: Floats) -> Array:
        """Return world points (N, 2) of points (N, 2) in the plate's axes."""
        return np.asarray(np.asarray(local, dtype=np.float64) @ self.rotation.T + self.shift)

    def moves(self, p: Floats) -> Array:
        """Return the derivative (..., 2, 3) of plate points, at p (..., 2) in the world, by shift and angle."""
        p = np.asarray(p, dtype=np.float64)
        out = np.zeros((*p.shape, 3))
        out[..., 0, 0] = out[..., 1, 1] = 1.0
        out[..., 0, 2], out[..., 1, 2] = -(p[..., 1] - self.shift[1]), p[..., 0] - self.shift[0]
        return out


def place_plate(plate: Plate, surveyed: Floats, *, sigma_mm: float | None = None) -> Placement:
    """Return where a plate lies whose reflectors were surveyed at (M, 2) mm, in the plate's order.

    Least squares over rotation and translation, in closed form, with fixed scale (EQ 6.12; program local2global).
    sigma_mm: noise of one surveyed coordinate, by default from the residuals. Raises `TooFewPoints`;
    `DegenerateGeometry` where the reflectors coincide, or where the survey does not fit this plate: if it fits in
    another order, that is named.
    """
    expect(plate, "plate", Plate)
    if sigma_mm is not None:
        expect_positive(sigma_mm, "sigma_mm of the survey", "a number of mm from 0 on", zero=True)
    q = frozen(surveyed, "surveyed reflectors", (None, 2))
    p = plate.reflectors
    if len(q) != len(p):
        raise BadValue("number of surveyed reflectors", len(q), f"{len(p)}, one for each of the plate's")
    if len(p) < 2:
        raise TooFewPoints("placing the plate", len(p), 2)
    if np.ptp(p, axis=0).max() == 0:
        raise DegenerateGeometry("all reflectors of the plate are at one place: its angle cannot be known")
    angle, shift = rigid_fit(p, q)
    fitted = Placement(plate, q, shift, angle, np.zeros((3, 2 * len(p))), 0.0)
    J = fitted.moves(fitted.at(p)).reshape(-1, 3)
    gain = np.asarray(np.linalg.solve(J.T @ J, J.T), dtype=np.float64)
    dof = 2 * len(p) - 3
    noise = float(np.sqrt(np.sum(fitted.residuals**2) / dof))
    allowed = plate.sigma_mm if sigma_mm is None else float(np.hypot(sigma_mm, plate.sigma_mm))
    if noise > _GROSS * allowed > 0:
        raise DegenerateGeometry(
            f"the surveyed reflectors are not those of this plate: they miss it by {fitted.rms:.2f} mm rms where "
            f"{allowed:.2g} mm are stated{_order_that_fits(plate, q, _GROSS * allowed)}"
        )
    own = noise if sigma_mm is None else sigma_mm
    return Placement(plate, q, shift, angle, gain, own, float(dof) if sigma_mm is None else np.inf)


def rigid_fit(p: Array, q: Array) -> tuple[float, Array]:
    """Return angle and translation (2,) that minimise |R p + t - q|^2 over points (N, 2)."""
    a, b = p - p.mean(axis=0), q - q.mean(axis=0)
    angle = float(np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b)))
    return angle, np.asarray(q.mean(axis=0) - turn(angle) @ p.mean(axis=0))


def turn(angle: float) -> Array:
    """Return the rotation (2, 2) of the plane."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def _order_that_fits(plate: Plate, q: Array, within: float) -> str:
    if len(q) > _MOST_ORDERS:
        return "; are they in the plate's order, and in mm?"
    p = plate.reflectors
    for order in permutations(range(len(p))):
        angle, shift = rigid_fit(p[list(order)], q)
        if np.sqrt(np.mean(np.sum((p[list(order)] @ turn(angle).T + shift - q) ** 2, axis=1))) < within:
            return f"; they would fit in the order {', '.join(plate.reflector_names[i] for i in order)}"
    return ", in no order; is it this plate, in mm, and not mirrored?"
