"""A rendered film of a block: found without a start, held while half covered, lost while hidden, found again."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from cadcam.geometry.rigid import Rigid
from cadcam.locate.photo import Photo
from cadcam.locate.track.frames import Frame
from cadcam.locate.track.tracker import TrackedFrame, track_part

from .scene import block, largest_miss, off, photo_of, pose_of

STEP = Rigid.exp([5.0, -3.0, 2.0, 0.006, 0.008, -0.005])  # some 5 px a frame
PARTLY, HIDDEN = range(4, 6), range(7, 9)
BACK, CUT = 9, 12  # frames before which the film jumps: while the part is hidden, and while it is seen
JUMPS = {BACK: (35.0, 130.0), CUT: (12.0, 40.0)}  # by degrees and px
N = 14


@dataclass(frozen=True)
class Film:
    """What was shown and what was found."""

    truth: list[Rigid]
    tracked: list[TrackedFrame]


def truth(rng: np.random.Generator) -> list[Rigid]:
    """Return camera_from_part in each frame: even motion but for the jumps."""
    poses = [pose_of(rng)]
    for k in range(1, N):
        poses.append(poses[-1] @ STEP)
        if k in JUMPS:
            poses[-1] = off(poses[-1], rng, degrees=JUMPS[k][0], px=JUMPS[k][1])
    return poses


def covered(photo: Photo, share: float) -> Photo:
    """Return the photo with a flat bright board before its right part."""
    gray = photo.gray.copy()
    gray[:, round((1 - share) * gray.shape[1]) :] = 0.75
    return replace(photo, gray=gray)


@cache
def film() -> Film:
    """Return the film, tracked without a start."""
    rng = np.random.default_rng(3)
    poses = truth(rng)
    photos = [photo_of(pose, rng) for pose in poses]
    shown = [
        covered(photo, 0.9 if k in HIDDEN else 0.5) if k in {*PARTLY, *HIDDEN} else photo
        for k, photo in enumerate(photos)
    ]
    return Film(poses, list(track_part(block(), [Frame.of(k, photo) for k, photo in enumerate(shown)])))


def test_the_part_is_found_in_every_frame_that_shows_it_and_in_no_other() -> None:
    assert [t.frame.index for t in film().tracked if not t.found] == list(HIDDEN)


def test_what_is_found_is_right_and_so_is_the_filtered_pose() -> None:
    """At the farthest corner, with some thousand samples good to some hundredths of a pixel."""
    for k, (pose, t) in enumerate(zip(film().truth, film().tracked, strict=True)):
        assert (t.filtered is not None) == t.found
        if t.filtered is not None:
            assert largest_miss(t.location.pose.world_from_part, pose) < 0.1, k
            assert largest_miss(t.filtered.world_from_part, pose) < 0.1, k


def test_it_is_found_by_the_cheapest_way() -> None:
    """Searched at first; foretold while it moves evenly, covered or not; searched where it was hidden and jumps far."""
    ways = [t.how for t in film().tracked]
    assert (ways[0], ways[BACK], ways[CUT]) == ("searched", "searched", "recovered")
    assert set(ways[1 : HIDDEN[0]]) == {"predicted"}
