"""Pictures that can show no part: what is wrong with them is their fault, and nothing else is."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.errors import BadValue, UnusablePhoto
from cadcam.locate.photo import Photo
from cadcam.locate.track import tracker
from cadcam.locate.track.tracker import track_part
from cadcam.locate.usable import check_exposure

from .moving import CAMERA, block, frames


@pytest.mark.parametrize(
    ("white", "says"), [(0.0, "empty: 98 % of it lies within 0.500 to 0.500"), (1.0, "100% black or white")]
)
def test_a_photo_without_contrast_or_of_two_tones_is_unusable(white: float, says: str) -> None:
    gray = np.full(CAMERA.size[::-1], 0.5, np.float32)
    gray[::2] += 0.5 * white
    gray[1::2] -= 0.5 * white
    with pytest.raises(UnusablePhoto, match=says):
        check_exposure(Photo.of(gray, CAMERA))
    check_exposure(Photo.of(0.2 + 0.6 * gray * np.linspace(0.2, 1, gray.shape[1]), CAMERA))


def test_what_is_no_fault_of_a_picture_is_no_lost_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    """A picture without contrast is; a wrong argument would be one in every frame, and say nothing of it."""

    def wrong(*_: object, **__: object) -> None:
        raise BadValue("search_px", -1.0, "a positive number")

    monkeypatch.setattr(tracker, "locate_part", wrong)
    with pytest.raises(BadValue, match="search_px"):
        list(track_part(block(), frames(1)))
