"""Videos come frame by frame, in grey; what is no video, and a missing decoder, are named."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from cadcam.errors import MissingExtra, UnreadableFile
from cadcam.image.video import count_frames, read_video

needs_opencv = pytest.mark.skipif(find_spec("cv2") is None, reason="OpenCV (cadcam[video]) is not installed")


def film(path: Path, values: list[int]) -> None:
    """Write a video whose n-th frame is of one grey value, with Motion JPEG, which every OpenCV has."""
    import cv2

    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10, (64, 48))
    for value in values:
        writer.write(np.full((48, 64, 3), value, np.uint8))
    writer.release()


@needs_opencv
def test_frames_come_in_their_order_as_grey_values_of_one(tmp_path: Path) -> None:
    """JPEG of a flat picture is good to a step of its quantised mean: 2 of 255."""
    values = [10, 200, 90, 255]
    film(tmp_path / "film.avi", values)
    frames = list(read_video(tmp_path / "film.avi"))
    assert [f.shape for f in frames] == [(48, 64)] * 4
    assert all(f.dtype == np.float32 for f in frames)
    np.testing.assert_allclose([255 * f.mean() for f in frames], values, atol=2)
    assert count_frames(tmp_path / "film.avi") == 4


@needs_opencv
@pytest.mark.parametrize("data", [b"", b"no video at all" * 100])
def test_what_is_no_video_is_refused(tmp_path: Path, data: bytes, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "film.avi").write_bytes(data)
    with pytest.raises(UnreadableFile, match=r"film.avi: (is not a video|holds no frame)"):
        list(read_video(tmp_path / "film.avi"))
    with pytest.raises(UnreadableFile, match="no such file"):
        list(read_video(tmp_path / "nothing.avi"))
    capfd.readouterr()


def test_without_opencv_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "film.mp4").write_bytes(b"x")
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(MissingExtra, match=r"cadcam\[video\]"):
        next(read_video(tmp_path / "film.mp4"))
