"""Frames of a video file as grey pictures, decoded one by one."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cadcam.arrays import Picture
from cadcam.errors import MissingExtra, UnreadableFile
from cadcam.image.picture import to_gray

SUFFIXES = (".mp4", ".avi", ".mov", ".mkv", ".m4v", ".webm", ".mpg", ".mpeg", ".wmv")
WHITE = 255.0  # of frames as they are decoded


def read_video(path: str | os.PathLike[str]) -> Iterator[Picture]:
    """Yield every frame of a video as a grey picture (H, W), float32 in [0, 1], in the order they are shown.

    Raises `MissingExtra` without OpenCV, `UnreadableFile` for what is not a video or holds no frame. A video that is
    cut off ends with its last whole frame.
    """
    video = _opened(path)
    try:
        number = 0
        while True:
            there, frame = video.read()
            if not there:
                break
            yield to_gray(frame[..., ::-1])  # OpenCV's order is blue first
            number += 1
        if number == 0:
            raise UnreadableFile(path, "holds no frame that can be decoded", "export it again, for instance as H.264")
    finally:
        video.release()


def count_frames(path: str | os.PathLike[str]) -> int | None:
    """Return how many frames a video says it has; None where it does not say."""
    video = _opened(path)
    try:
        count = int(video.get(_cv2().CAP_PROP_FRAME_COUNT))
    finally:
        video.release()
    return count if count > 0 else None


def _opened(path: str | os.PathLike[str]) -> Any:
    if not Path(path).exists():
        raise UnreadableFile(path, "no such file", "check the path")
    video = _cv2().VideoCapture(os.fspath(path))
    if not video.isOpened():
        raise UnreadableFile(path, "is not a video that OpenCV can decode", "export it again, for instance as H.264")
    return video


def _cv2() -> Any:
    try:
        import cv2
    except ImportError:
        raise MissingExtra("reading a video file", "video", "opencv-python-headless") from None
    return cv2
