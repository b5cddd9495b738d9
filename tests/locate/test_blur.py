"""What a blur hides beside edges is told: in the pose's covariance, and in how near to lines steps are looked for."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from cadcam.geometry.rigid import Rigid
from cadcam.locate.freedom import FREE
from cadcam.locate.lines.sight import Sight
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.refine import answer
from cadcam.locate.refine.options import EDGES
from cadcam.locate.refine.solution import PoseSolution, solved

from .photos import CAMERA, noisy, shot

DRAWN = 4000


def solution(part: Part, pose: Rigid, blur: float, rng: np.random.Generator) -> PoseSolution:
    photo = Photo.of(noisy(gaussian_filter(shot(part, pose), blur), 0.01, rng), CAMERA)
    sight = Sight.of(part, photo, pose, step_px=EDGES.step_px, reach_px=2 * EDGES.reach_px)
    return solved([sight], pose, FREE, (), EDGES)


def test_nothing_is_hidden_in_a_sharp_photo(part: Part, pose: Rigid, rng: np.random.Generator) -> None:
    sharp = solution(part, pose, 0.3, rng)
    assert not sharp.hidden_px.any()
    assert not sharp.hidden_by_blur.any()


def test_what_blur_hides_moves_the_pose_as_edges_that_are_off_by_so_much_do(
    part: Part, pose: Rigid, rng: np.random.Generator
) -> None:
    """Each piece of edge drawn at random by what is hidden: the poses' covariance is the one told, to 4 sd of one."""
    blurred = solution(part, pose, 1.5, rng)
    shift = blurred.hidden_px
    assert shift.max() > 0
    n = len(shift)
    each = rng.standard_normal((DRAWN, int(blurred.fit.group.max()) + 1))[:, blurred.fit.group[:n]]
    moved = (each * shift) @ blurred.fit.gain[:, :n].T
    told = blurred.hidden_by_blur
    seen = moved.T @ moved / DRAWN
    sd = np.sqrt((told**2 + np.outer(np.diag(told), np.diag(told))) / DRAWN)
    assert (np.abs(seen - told) < 4 * sd).all()


def test_edges_that_blur_hides_something_beside_count_as_scattered_by_that_too(
    part: Part, pose: Rigid, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[float] = []
    judged = answer.judged_support
    monkeypatch.setattr(answer, "judged_support", lambda *a, **k: (asked.append(k["scatter"]), judged(*a, **k))[1])
    for blur in (0.3, 1.5):
        one = solution(part, pose, blur, rng)
        answer.location_of(part, one, FREE, chosen=0, wider=False)
        hidden = np.sqrt(np.mean(one.hidden_px**2))
        assert asked[-1] == pytest.approx(np.sqrt(one.scatter**2 + hidden**2), rel=1e-12)
        assert (hidden > 0) == (blur > 1)
