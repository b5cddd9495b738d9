"""A rig from pictures of a calibration board: detection by each camera, outliers left out, then joint adjustment."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from cadcam.arrays import Brief
from cadcam.calibrate.boards.pictures import BoardCalibration, BoardPicture, calibrate_boards
from cadcam.calibrate.rig.adjustment import RigCamera, by_camera, calibrate_rig
from cadcam.camera.camera import Camera
from cadcam.camera.extended_pinhole import INTERNALS, internals_by_name
from cadcam.camera.lens import Lens
from cadcam.camera.observations import Observations
from cadcam.camera.rig_estimate import RigEstimate
from cadcam.errors import BadValue
from cadcam.kinds import expect


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class RigBoards(Brief):
    """A rig from pictures of a board, and the outcome for each camera's pictures in its calibration by itself."""

    estimate: RigEstimate
    alone: Mapping[str, BoardCalibration]


def calibrate_rig_boards(
    pictures: Mapping[str, Sequence[BoardPicture | None]],
    *,
    frames: Sequence[str] = (),
    known: Mapping[str, Camera] | None = None,
    fixed: Mapping[str, float] | None = None,
    lens: Lens | None = None,
    free_lens: Iterable[str] | None = None,
    keep_all: bool = False,
) -> RigBoards:
    """Return the rig whose cameras took these pictures, the n-th of each at the same moment, None for no picture.

    fixed, lens, free_lens, keep_all: as in `calibrate_boards`, for all cameras that are not `known`. Outlier points and
    pictures are those of each camera by itself; a frame may lose the pictures of some cameras. Raises what
    `calibrate_boards` and `calibrate_rig` raise.
    """
    expect(pictures, "pictures", Mapping)
    counts = {name: len(taken) for name, taken in pictures.items()}
    if len(set(counts.values())) > 1:
        raise BadValue(
            "the number of pictures", by_camera(counts), "one number for all: the n-th of each were taken together"
        )
    known, free_lens = known or {}, None if free_lens is None else tuple(free_lens)
    alone, cameras = {}, {}
    for name, row in pictures.items():
        taken = [p for p in row if p is not None]
        if name in known:
            held = internals_by_name(known[name])
            found = calibrate_boards(taken, fixed=held, lens=known[name].lens, keep_all=keep_all)
            cameras[name] = RigCamera(_views(row, found), known=known[name])
        else:
            found = calibrate_boards(taken, fixed=fixed, lens=lens, free_lens=free_lens, keep_all=keep_all)
            cameras[name] = _as_found(row, found)
        alone[name] = found
    return RigBoards(calibrate_rig(cameras, frames=frames), alone)


def _as_found(row: Sequence[BoardPicture | None], found: BoardCalibration) -> RigCamera:
    """Return the camera with the same parameters free as in its calibration by itself."""
    free, estimate = found.fit.model.free, found.estimate
    held = {n: estimate.value(n) for n in INTERNALS if n not in free}
    terms = tuple(n for n in free if n not in INTERNALS)
    return RigCamera(_views(row, found), found.fit.size, held, estimate.camera.lens, terms)


def _views(row: Sequence[BoardPicture | None], found: BoardCalibration) -> list[Observations | None]:
    places = [j for j, p in enumerate(row) if p is not None]
    views: list[Observations | None] = [None] * len(row)
    for i, view in zip(found.used, found.estimate.views, strict=True):
        views[places[i]] = view
    return views
