"""The numbers in the names of pictures say which are missing, and whether those of two cameras belong together."""

from __future__ import annotations

from pathlib import Path

import pytest

from cadcam.camera.viewpoint import Viewpoint
from cadcam.errors import BadValue
from cadcam.geometry.rigid import Rigid
from cadcam.locate.track.frames import Frames

from .moving import CAMERA


def two_cameras(tmp_path: Path, left: list[str], right: list[str]) -> Frames:
    """Return the frames of two folders of empty files of these names."""
    for folder, names in (("left", left), ("right", right)):
        (tmp_path / folder).mkdir()
        for name in names:
            (tmp_path / folder / name).touch()
    views = [Viewpoint.exact(name, CAMERA, Rigid(), sigma_px=0.1) for name in ("left", "right")]
    return Frames([tmp_path / "left", tmp_path / "right"], views)


def test_two_cameras_that_each_lack_another_picture_are_refused(tmp_path: Path) -> None:
    """As many pictures of each, but from the first gap on no two were taken together."""
    left, right = ([f"{start + n}.png" for n in range(12) if n != gap] for start, gap in ((0, 5), (100, 9)))
    with pytest.raises(BadValue, match=r"pictures of frame 5 .*left/6\.png and .*right/105\.png; .*a camera lacks a"):
        two_cameras(tmp_path, left, right)


@pytest.mark.parametrize(
    ("left", "right", "said"),
    [
        ([f"{n}.png" for n in range(12)], [f"a{n + 7:04d}.png" for n in range(12)], ()),
        ([f"{n}.png" for n in (0, 1, 2, 4, 5)], [f"{n}.png" for n in (0, 1, 2, 4, 5)], ("1 missing", "1 missing")),
        ([f"{n}.png" for n in (3, 14, 15, 92)], [f"{n}.png" for n in (3, 13, 15, 93)], ()),  # times
        (["a.png", "b.png"], ["c.png", "d.png"], ()),
        ([f"{n}_v2.png" for n in range(4)], [f"{n}.png" for n in (0, 1, 2, 9)], ("6 missing",)),
        (["1.png"], ["7.png"], ()),
    ],
    ids=["other numbers", "the same gap", "times", "no numbers", "one counts", "one picture"],
)
def test_pictures_that_may_belong_together_are_taken(
    tmp_path: Path, left: list[str], right: list[str], said: tuple[str, ...]
) -> None:
    gaps = two_cameras(tmp_path, left, right).gaps
    assert [gap for gap, words in zip(gaps, said, strict=True) if words not in gap] == []
