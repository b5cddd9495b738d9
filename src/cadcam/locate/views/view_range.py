"""The viewpoints from which a part may be seen, as the user declares them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from cadcam.arrays import Array, Brief, Floats, Mask, frozen
from cadcam.errors import BadValue
from cadcam.kinds import expect, expect_number, expect_numbers
from cadcam.locate.views.resting import OnPlane


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ViewRange(Brief):
    """The viewpoints from which a part may be seen: directions, rolls in the picture, distances.

    axis (3,): from the part's centre to the camera, in the part frame; views within half_angle_deg of it are allowed.
    up (3,): a direction of the part that is at most roll_deg from upright in the picture. distance_mm: least and
    greatest distance of the part's centre from the camera; by default those at which the part's size is 0.2 to 1.2 of
    the photo's shorter side. on: a plane that the part lies on; at each place of a photo that alone leaves few views
    and one distance, so that none need be declared.
    """

    axis: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    half_angle_deg: float = 180.0
    up: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    roll_deg: float = 180.0
    distance_mm: tuple[float, float] | None = None
    on: OnPlane | None = None

    def __post_init__(self) -> None:
        for name in ("axis", "up"):
            vector = frozen(getattr(self, name), f"{name} of the views", (3,))
            if not np.linalg.norm(vector) > 0:
                raise BadValue(f"{name} of the views", vector.tolist(), "a direction, not zero")
            object.__setattr__(self, name, frozen(vector / np.linalg.norm(vector), name, (3,)))
        for name, value in (("half_angle_deg", self.half_angle_deg), ("roll_deg", self.roll_deg)):
            expect_number(value, f"{name} of the views")
            if not 0 <= value <= 180:
                raise BadValue(f"{name} of the views", value, "0 to 180 degrees")
        expect(self.distance_mm, "distance_mm of the views", tuple, list, optional=True)
        expect_numbers(self)
        if self.distance_mm is not None and not 0 < self.distance_mm[0] <= self.distance_mm[1] < math.inf:
            raise BadValue("distance_mm of the views", self.distance_mm, "(least, greatest), both positive")
        expect(self.on, "on of the views", OnPlane, optional=True)
        if self.on is not None and self.roll_deg < 180:
            raise BadValue("roll_deg of the views", self.roll_deg, "180 (any) on a plane, where the part may be turned")

    @classmethod
    def above(cls, *, within_deg: float = 80.0, distance_mm: tuple[float, float] | None = None) -> ViewRange:
        """Return the views from above, at any roll, of a part that lies or stands as modelled, its z axis up."""
        return cls(half_angle_deg=within_deg, distance_mm=distance_mm)

    @property
    def anywhere(self) -> bool:
        """Return whether nothing is declared: the part may be seen from anywhere, at any distance."""
        return self.half_angle_deg >= 180 and self.roll_deg >= 180 and self.distance_mm is None and self.on is None

    def allows(self, directions: Floats) -> Mask:
        """Return which unit directions (N, 3) from the part's centre to the camera are in range."""
        cosine = np.asarray(directions, dtype=np.float64) @ self.axis
        return np.asarray(cosine >= math.cos(math.radians(min(self.half_angle_deg, 180.0))) - 1e-9)


WHOLE_SPHERE = ViewRange()
