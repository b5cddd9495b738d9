"""A test of the values that a calibration holds fixed, by a fit that leaves them free."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from cadcam.calibrate.points.camera import calibrate_camera
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.extended_pinhole import NAMES
from cadcam.errors import CadcamError

_LEVEL = 1e-3  # significance level of a contradiction
_ROUNDING = 1e-9  # px: smaller residuals count as zero


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """Parameters that were held, the estimate that leaves them free, and the p-value of the test.

    It is the chance that points which agree with the held values gain as much by leaving them free: of the F-test, or
    of chi squared where the pixels' noise is stated (Seber and Wild, "Nonlinear Regression", 1989, section 5.3).
    """

    names: tuple[str, ...]
    free: CameraEstimate
    chance: float

    @property
    def contradicted(self) -> bool:
        """Return whether the points contradict what was held."""
        return self.chance < _LEVEL


def held_against(estimate: CameraEstimate, names: Sequence[str]) -> Held | None:
    """Return the test of held parameters by the points of an estimate; None where they do not determine these."""
    from scipy.stats import chi2, f

    held = tuple(name for name in names if name not in estimate.free)
    if not held:
        return None
    still = {name: estimate.value(name) for name in NAMES if name not in (*estimate.free, *held)}
    lens = estimate.camera.lens
    terms = [name for name in lens.parameters if name in estimate.free]
    try:
        free = calibrate_camera(estimate.observations, estimate.camera.size, fixed=still, lens=lens, free_lens=terms)
    except CadcamError:
        return None
    if free.dof < 1:
        return None
    gained = max(estimate.sum_of_squares - free.sum_of_squares, 0.0)
    if estimate.stated_px is not None:
        return Held(held, free, float(chi2.sf(gained / estimate.stated_px**2, len(held))))
    spread = max(free.sum_of_squares / free.dof, _ROUNDING**2)
    return Held(held, free, float(f.sf(gained / len(held) / spread, len(held), free.dof)))
