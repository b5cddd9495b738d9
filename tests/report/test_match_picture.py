"""What was found shows where the whole of a photo is looked at, however many pixels it has."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Mask
from cadcam.image.correlate import Peaks
from cadcam.image.template import Template
from cadcam.report.match_picture import with_peaks


def drawn(times: int) -> Mask:
    """Return which pixels are coloured of a photo of 900 x 600 px, each side so many times larger, and its template."""
    template = Template(np.random.default_rng(0).uniform(size=(40 * times, 60 * times)))
    at = np.array([[450.0, 300.0]]) * times
    peaks = Peaks(at, np.zeros(1), np.ones(1), np.ones(1), np.zeros((1, 4, 4)))
    picture = with_peaks(np.zeros((600 * times, 900 * times), np.float32), template, peaks)
    return np.asarray(picture.max(axis=2) > 0.3)


def test_marks_grow_with_the_photo() -> None:
    """Four times the size is sixteen times the pixels, less or more by soft borders; lines of one width gave four."""
    once, larger = drawn(1).sum(), drawn(4).sum()
    assert larger > 8 * once


def test_a_small_template_in_a_large_photo_is_not_hidden_by_its_outline() -> None:
    template = Template(np.random.default_rng(0).uniform(size=(48, 48)))
    peaks = Peaks(np.array([[3000.0, 2000.0]]), np.zeros(1), np.ones(1), np.ones(1), np.zeros((1, 4, 4)))
    seen = with_peaks(np.zeros((4000, 6000), np.float32), template, peaks)[1976:2024, 2976:3024].max(axis=2)
    assert (seen[:24] < 0.3).mean() > 0.5
