"""Boards in pictures: our detection and calibration compared with OpenCV's and the published values.

    python benchmarks/real_boards.py ../shared/data [--only rendered,left,...]

First rendered boards, where the truth is known: rms and mean error of points, px. Then real sets, the same pictures and
the same camera model: "ours" finds and calibrates, "cv2 ..." is OpenCV's detector with `cv2.calibrateCamera`. The rms
is of one pixel coordinate. Needs opencv-python-headless; h5py for the wall of dots.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cadcam.arrays import Array, Picture
from cadcam.calibrate.boards.pictures import calibrate_boards, find_board
from cadcam.calibrate.joint.adjustment import calibrate_jointly
from cadcam.calibrate.points.camera import locate_camera
from cadcam.calibrate.rig.adjustment import RigCamera, calibrate_rig
from cadcam.calibrate.rig.boards import calibrate_rig_boards
from cadcam.camera.camera import Camera
from cadcam.camera.joint_estimate import JointEstimate
from cadcam.camera.lens import BrownConrady
from cadcam.camera.observations import Observations
from cadcam.camera.sensitivity import twist_by_local
from cadcam.errors import CadcamError
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import read_picture, to_gray
from cadcam.target.boards import opencv
from cadcam.target.boards.board import Pattern
from cadcam.target.boards.circles import disc_grid, disc_shift
from cadcam.target.boards.detect import detect
from cadcam.target.boards.grid import Grid
from cadcam.target.boards.pattern import Chessboard, CircleGrid, parse_pattern
from cadcam.target.marks.ideal import board_picture

CAMERA = Camera.from_focal((640, 480), 560.0, cx=325.0, cy=236.0, lens=BrownConrady(k1=-0.22, k2=0.07))
RENDERED = ("chessboard:9x6:25mm", "charuco:8x6:30mm:22mm:5X5_100", "circles:8x6:26mm:14mm",
            "staggered-circles:4x9:20mm:14mm")  # fmt: skip
CASES = ((0, 0.5, 0.0), (0, 0.8, 0.01), (20, 0.8, 0.01), (40, 0.8, 0.01), (55, 0.8, 0.01), (30, 1.6, 0.02))
TERMS = ("k1", "k2", "p1", "p2")

Finder = Callable[[Picture], Array | None]


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    arguments.add_argument("data", type=Path)
    arguments.add_argument("--only", default="rendered,left,right,pair,franka,circles,zhang,dots")
    given = arguments.parse_args()
    studies: dict[str, Callable[[], None]] = {
        "rendered": rendered,
        "left": lambda: stereo(given.data, "left"),
        "right": lambda: stereo(given.data, "right"),
        "pair": lambda: pair(given.data),
        "franka": lambda: franka(given.data),
        "circles": lambda: circles(given.data),
        "zhang": lambda: zhang(given.data),
        "dots": lambda: dots(given.data),
    }
    for name in given.only.split(","):
        studies[name]()
        sys.stdout.flush()


def rendered() -> None:
    print("rendered boards, 640 x 480, k1 = -0.22: rms error of a coordinate (mean error), px; predicted: by the fit\n")
    print(f"{'board':32} {'tilt':>4} {'blur':>4} {'noise':>5}   {'ours':>16} {'predicted':>9}   others")
    for text in RENDERED:
        pattern = parse_pattern(text)
        for tilt, blur, noise in CASES:
            at = _pose(pattern, tilt)
            picture = board_picture(pattern, CAMERA, at, blur_px=blur, noise=noise, rng=np.random.default_rng(7)).clip(
                0, 1
            )
            _rendered_row(pattern, at, picture, f"{text.split('mm')[0]:32} {tilt:4} {blur:4} {noise:5}")
    print()


def _rendered_row(pattern: Pattern, at: Rigid, picture: Picture, head: str) -> None:
    truth = CAMERA.project(at @ pattern.points)
    shift = np.zeros_like(truth)
    if isinstance(pattern, CircleGrid):
        shift = disc_shift(CAMERA, at, pattern.points, pattern.printed_diameter_mm / 2)
    try:
        found = detect(picture, pattern)
        ours, sigma = _nearest_error(found.q - shift[found.points], truth), f"{found.sigma_px:9.4f}"
    except CadcamError:
        ours, sigma = "not found", ""
    others = [f"{name} {_nearest_error(q, truth)}" for name, q in _others(pattern, picture)]
    print(f"{head}   {ours:>16} {sigma:>9}   {'; '.join(others)}")


def _others(pattern: Pattern, picture: Picture) -> Iterator[tuple[str, Array]]:
    if isinstance(pattern, Chessboard):
        for name, q in opencv.chessboard_candidates(picture, pattern.columns, pattern.rows):
            short = name.removeprefix("cv2.findChessboard")
            yield short, q
            if short == "Corners":
                yield "Corners + cornerSubPix", _sub_pixel(picture, q)
    elif isinstance(pattern, CircleGrid):
        answers = opencv.circle_candidates(picture, pattern.columns, pattern.rows, staggered=pattern.staggered)
        for name, _, q in list(answers)[:1]:
            yield name.removeprefix("cv2."), q
    else:
        yield from _cv2_charuco(pattern, picture)


def _cv2_charuco(pattern: Any, picture: Picture) -> Iterator[tuple[str, Array]]:
    import cv2

    board = cv2.aruco.CharucoBoard(
        (pattern.columns, pattern.rows), pattern.square_mm, pattern.marker_mm, opencv.dictionary(pattern.dictionary)
    )
    corners, _, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(opencv.as_bytes(picture))
    if corners is not None and len(corners):
        yield "CharucoDetector", opencv.pixels(corners)


def _sub_pixel(picture: Picture, q: Array, half: int = 5) -> Array:
    import cv2

    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
    start = q.astype(np.float32).reshape(-1, 1, 2)
    return opencv.pixels(cv2.cornerSubPix(opencv.as_bytes(picture), start, (half, half), (-1, -1), stop))


def _error(q: Array, truth: Array) -> str:
    e = q - truth
    return f"{np.sqrt(np.mean(e**2)):.4f} ({np.abs(e.mean(axis=0)).max():.4f})"


def _nearest_error(q: Array, truth: Array) -> str:
    nearest = np.linalg.norm(q[:, None] - truth, axis=2).argmin(axis=1)
    lost = len(truth) - len(q)
    return _error(q, truth[nearest]) + (f" {lost} lost" if lost else "")


def _pose(pattern: Pattern, tilt: float) -> Rigid:
    left, top, right, bottom = pattern.outline
    middle = Rigid(np.eye(3), np.array([-(left + right) / 2, -(top + bottom) / 2, 0.0]))
    turn = Rigid.exp([0, 0, 0, *np.radians([0.4 * tilt, tilt, 7.0])])
    return Rigid(np.eye(3), np.array([6.0, -4.0, 1.75 * (right - left)])) @ turn @ middle


def stereo(data: Path, side: str) -> None:
    files = sorted((data / "opencv_stereo_chess").glob(f"{side}*.jpg"))
    published = {"left": "shipped left_intrinsics.yml (aspect 1, with k3)", "right": ""}[side]
    values = {"left": (535.92, 535.92, 342.28, 235.57, -0.2664, -0.0386), "right": None}[side]
    _study(f"opencv_stereo_chess, {side}", files, "chessboard:9x6:25mm", TERMS, published, values)


def pair(data: Path) -> None:
    """Calibrate both cameras as a rig, beside `cv2.stereoCalibrate` with its own corners and with ours."""
    pattern = parse_pattern("chessboard:9x6:25mm")
    files = {side: sorted((data / "opencv_stereo_chess").glob(f"{side}*.jpg")) for side in ("left", "right")}
    print(f"opencv_stereo_chess, the pair as a rig: {len(files['left'])} frames, {pattern}\n")
    print(f"{'':50} {'frames':>6} {'rms px':>7} {'base mm':>8} {'X mm':>8} {'Y mm':>7} {'Z mm':>7} "
          f"{'rx deg':>7} {'ry deg':>7} {'rz deg':>7}   focal px left, right")  # fmt: skip
    found = {side: [find_board(f, pattern) for f in row] for side, row in files.items()}
    ours = calibrate_rig_boards(found).estimate
    pose = ours.relative("left", "right")
    focal = [ours.cameras[c].fy for c in range(2)]
    _pair_row("ours", len(ours.frames), ours.rms_px, pose.b_from_a, focal)
    for head, by_frame in (("  +- (every pixel independent)", False), ("  +- (between frames)", True)):
        F, C = pose.b_from_a.origin, pose.by_frame if by_frame else pose.covariance
        assert C is not None
        B = twist_by_local(F)
        place, turn = np.sqrt(np.diag(B @ C @ B.T)[:3]), np.degrees(np.sqrt(np.diag(C)[3:]))
        sigma = [ours.sigma(name, "focal", by_frame=by_frame) for name in ours.names]
        _pair_numbers(head, "", "", pose.baseline_sigma(by_frame=by_frame), place, turn, sigma)
    apart = {s: calibrate_boards(row).estimate.camera for s, row in found.items()}
    held = {s: RigCamera(list(v), known=apart[s]) for s, v in zip(ours.names, ours.views, strict=True)}
    kept = calibrate_rig(held)
    _pair_row("ours, internals of each camera by itself kept", len(kept.frames), kept.rms_px,
              kept.relative("left", "right").b_from_a, [c.fy for c in kept.cameras])  # fmt: skip
    q = {s: [p.detection.q for p in row if p.detection is not None] for s, row in found.items()}
    _cv2_pair("cv2.stereoCalibrate, our corners", q, pattern)
    for name, finder in list(_cv2_finders(pattern))[1:]:
        corners = {s: [finder(to_gray(read_picture(f))) for f in row] for s, row in files.items()}
        both = [k for k in range(13) if all(corners[s][k] is not None for s in corners)]
        seen = {s: [c for k in both if (c := corners[s][k]) is not None] for s in corners}
        _cv2_pair(f"cv2.stereoCalibrate, {name.removeprefix('cv2.')}", seen, pattern)
    print()


def _cv2_pair(name: str, q: dict[str, list[Array]], pattern: Pattern) -> None:
    """Internals of each camera first, then all together: what OpenCV's own example does."""
    import cv2

    points = [pattern.points.astype(np.float32)] * len(q["left"])
    pixels = {s: [c.astype(np.float32).reshape(-1, 1, 2) for c in row] for s, row in q.items()}
    (_, K1, d1, *_), (_, K2, d2, *_) = (
        cv2.calibrateCamera(points, pixels[s], (640, 480), None, None, flags=cv2.CALIB_FIX_K3)
        for s in ("left", "right")
    )
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-10)
    rms, K1, _, K2, _, R, T, *_ = cv2.stereoCalibrate(
        points, pixels["left"], pixels["right"], K1, d1, K2, d2, (640, 480), flags=flags, criteria=stop
    )
    right_from_left = Rigid(R, np.ravel(T))
    _pair_row(name, len(points), rms / np.sqrt(2), right_from_left, [K1[1, 1], K2[1, 1]])


def _pair_row(name: str, frames: int, rms: float, right_from_left: Rigid, focal: Sequence[float]) -> None:
    F = right_from_left.origin
    turn = np.degrees(so3.log(right_from_left.rotation))
    _pair_numbers(name, f"{frames}", f"{rms:.4f}", float(np.linalg.norm(F)), F, turn, focal)


def _pair_numbers(
    name: str, frames: str, rms: str, base: float, place: Array, turn: Array, focal: Sequence[float]
) -> None:
    print(f"{name:50} {frames:>6} {rms:>7} {base:8.3f} {place[0]:8.3f} {place[1]:7.3f} {place[2]:7.3f} "
          f"{turn[0]:7.3f} {turn[1]:7.3f} {turn[2]:7.3f}   {focal[0]:.2f} {focal[1]:.2f}")  # fmt: skip


def franka(data: Path) -> None:
    files = sorted((data / "visp_franka_eye_in_hand").glob("*.png"))
    _study("visp_franka_eye_in_hand", files, "chessboard:9x6:23.6mm", ("k1", "k2"), "the camera's factory values",
           (607.59, 607.57, 323.46, 243.26, 0.0, 0.0))  # fmt: skip


def circles(data: Path) -> None:
    files = sorted((data / "visp_circles").glob("*.jpg"))
    _study("visp_circles", files, "circles:6x6:34mm", ("k1",), "", None)


def zhang(data: Path) -> None:
    """Zhang's 64 squares: their centres as a grid of blobs, 8 x 8, beside his corners and his published values."""
    folder = data / "zhang_planar"
    files = sorted((folder / "images").glob("*.png"))
    model = np.loadtxt(folder / "Model.txt").reshape(-1, 4, 2)
    step = 25.4 * float(np.median(np.diff(np.unique(model.mean(axis=1)[:, 0].round(4)))))
    _study("zhang_planar, centres of the squares", files, f"circles:8x8:{step:.6g}mm", ("k1", "k2"),
           "published by Zhang, from the squares' 256 corners", (832.5, 832.53, 303.959, 206.585, -0.228601, 0.190353),
           fixed={})  # fmt: skip


def _study(
    title: str,
    files: Sequence[Path],
    text: str,
    terms: tuple[str, ...],
    published: str,
    values: tuple[float, ...] | None,
    fixed: dict[str, float] | None = None,
) -> None:
    pattern = parse_pattern(text)
    print(f"{title}: {len(files)} pictures, {text}\n")
    print(f"{'':50} {'views':>5} {'points':>6} {'rms px':>7} {'fx':>8} {'fy':>8} {'cx':>8} {'cy':>8}   lens")
    ours = calibrate_boards([find_board(f, pattern) for f in files], lens=BrownConrady(), free_lens=terms, fixed=fixed)
    _our_rows("ours", ours.estimate)
    for i, why in ours.left_out.items():
        print(f"  left out: {Path(ours.pictures[i].name).name}: {why}")
    for name, finder in _cv2_finders(pattern):
        _cv2_row(name, finder, files, pattern, terms)
    if values is not None:
        fx, fy, cx, cy, *k = values
        print(f"{published:50} {'':5} {'':6} {'':7} {fx:8.2f} {fy:8.2f} {cx:8.2f} {cy:8.2f}   "
              + " ".join(f"{name} {v:+.4f}" for name, v in zip(("k1", "k2"), k, strict=True)))  # fmt: skip
    print()


def _our_rows(name: str, e: JointEstimate) -> None:
    points = sum(len(v) for v in e.views)
    _row(name, len(e.views), points, e.rms_px, e.camera)
    for head, by_view in (("  +- (every pixel independent)", False), ("  +- (between views)", True)):
        sigma = {n: e.sigma(n, by_view=by_view) for n in e.free}
        fy = sigma.get("focal", 0.0)
        fx = float(np.hypot(fy, e.value("focal") * sigma.get("aspect", 0.0)))
        lens = " ".join(f"{n} {s:.4f}" for n, s in sigma.items() if n[0] in "kp" and n[1].isdigit())
        print(f"{head:50} {'':5} {'':6} {'':7} {fx:8.2f} {fy:8.2f} {sigma['V0']:8.2f} {sigma['U0']:8.2f}   {lens}")
    if "skew" in e.free:
        print(f"  skew {e.camera.skew:.3f} px")


def _row(name: str, views: int, points: int, rms: float, camera: Camera) -> None:
    cx, cy = camera.principal_point
    lens = " ".join(f"{n} {v:+.4f}" for n, v in camera.lens.parameters.items() if v)
    print(f"{name:50} {views:5} {points:6} {rms:7.4f} {camera.fx:8.2f} {camera.fy:8.2f} {cx:8.2f} {cy:8.2f}   {lens}")


def _cv2_finders(pattern: Pattern) -> Iterator[tuple[str, Finder]]:
    def answer(name: str, *, sub_pixel: bool = False) -> Finder:
        def find(picture: Picture) -> Array | None:
            if isinstance(pattern, CircleGrid):
                answers = opencv.circle_candidates(picture, pattern.columns, pattern.rows, staggered=pattern.staggered)
                return next((q for n, _, q in answers), None)
            q = dict(opencv.chessboard_candidates(picture, pattern.columns, pattern.rows)).get(name)
            return _sub_pixel(picture, q) if q is not None and sub_pixel else q

        return find

    if isinstance(pattern, CircleGrid):
        yield "cv2.findCirclesGrid", answer("")
    else:
        yield "cv2.findChessboardCornersSB", answer("cv2.findChessboardCornersSB")
        yield "cv2.findChessboardCorners", answer("cv2.findChessboardCorners")
        yield "cv2.findChessboardCorners + cornerSubPix 11 x 11", answer("cv2.findChessboardCorners", sub_pixel=True)


def _cv2_row(name: str, finder: Finder, files: Sequence[Path], pattern: Pattern, terms: tuple[str, ...]) -> None:
    import cv2

    corners = [finder(to_gray(read_picture(f))) for f in files]
    q = [c.astype(np.float32).reshape(-1, 1, 2) for c in corners if c is not None]
    if len(q) < 3:
        print(f"{name:50} {len(q):5} found")
        return
    height, width = to_gray(read_picture(files[0])).shape
    p = [pattern.points.astype(np.float32)] * len(q)
    held = cv2.CALIB_FIX_K3
    held |= 0 if "p1" in terms else cv2.CALIB_ZERO_TANGENT_DIST
    held |= 0 if "k2" in terms else cv2.CALIB_FIX_K2
    rms, K, d, *_ = cv2.calibrateCamera(p, q, (width, height), None, None, flags=held)
    camera = Camera.from_opencv((width, height), K, np.ravel(d)[:5])
    _row(name, len(q), sum(len(c) for c in q), rms / np.sqrt(2), camera)


def dots(data: Path) -> None:
    """Calibrate from a wall of dots at their published places, beside the published camera."""
    try:
        import h5py
    except ImportError:
        print("opencsp_dots: h5py reads its published places, and is not installed: left out\n")
        return
    folder = data / "opencsp_dots"
    with h5py.File(folder / "data_measurement/camera_calibration.h5") as file:
        K, d = np.array(file["Camera/intrinsic_mat"]), np.array(file["Camera/distortion_coef"])
    with h5py.File(folder / "data_expected/fixed_pattern_dot_locations.h5") as file:
        wall = 1e3 * np.array(file["DotLocationsFixedPattern/xyz_dot_loc"])
    published = Camera.from_opencv((2160, 1440), np.array([*K[:2], [0, 0, 1]]), d)
    off = _off_plane(wall.reshape(-1, 3))
    print(f"opencsp_dots: 5 pictures of a wall of 64 x 64 dots at published places, {off:.1f} mm rms off a plane\n")
    views, errors, turns = [], [], list(_TURNS)
    for file in sorted((folder / "data_measurement/images").glob("*.JPG")):
        grid = disc_grid(to_gray(read_picture(file)), window=0.03, light=False, staggered=False, enough=4096)
        if grid is None:
            print(f"{file.name}: nothing")
            continue
        view, error, turn = _on_wall(grid, wall, published, turns, file.name)
        turns = [turn]  # the camera was not turned between the pictures
        fit = np.median(np.sqrt(np.einsum("nii->n", grid.fit.covariance) / 2))
        print(f"{file.name}: {len(grid)} dots found, {len(view)} of them published; fit says {fit:.3f} px")
        views.append(view)
        errors.append(error)
    print(f"\n{'':50} {'views':>5} {'points':>6} {'rms px':>7} {'fx':>8} {'fy':>8} {'cx':>8} {'cy':>8}   lens")
    points = sum(len(v) for v in views)
    _our_rows("ours", calibrate_jointly(views, (2160, 1440), fixed={"skew": 0.0}, lens=BrownConrady(), free_lens=TERMS))
    _row(
        "published camera, poses by our dots", len(views), points, float(np.sqrt(np.mean(np.square(errors)))), published
    )
    print()


_TURNS = [np.array(m).reshape(2, 2) for m in ((1, 0, 0, 1), (1, 0, 0, -1), (-1, 0, 0, 1), (-1, 0, 0, -1),
                                              (0, 1, 1, 0), (0, 1, -1, 0), (0, -1, 1, 0), (0, -1, -1, 0))]  # fmt: skip


def _off_plane(p: Array) -> float:
    p = p[np.isfinite(p).all(axis=1)]
    return float(np.linalg.svd(p - p.mean(axis=0), compute_uv=False)[2] / np.sqrt(len(p)))


def _on_wall(
    grid: Grid, wall: Array, camera: Camera, turns: Sequence[Array], name: str
) -> tuple[Observations, float, Array]:
    """Return a picture's dots at the places on the wall that fit best, their rms with a camera, and the turn."""
    best: tuple[float, Array, Array] | None = None
    for turn in turns:
        cells = grid.cells @ turn.T
        cells -= cells.min(axis=0)
        room = 64 - cells.max(axis=0)
        for shift in np.ndindex(*np.maximum(room, 0)):
            p = wall[cells[:, 1] + shift[1], cells[:, 0] + shift[0]]
            known = np.flatnonzero(np.isfinite(p).all(axis=1))
            few = known[:: max(1, len(known) // 80)]
            try:
                rms = locate_camera(Observations(p[few], grid.fit.q[few]), camera).rms_px
            except CadcamError:
                continue
            if best is None or rms < best[0]:
                best = rms, p, turn
    if best is None:
        raise SystemExit(f"{name}: its dots lie nowhere on the wall")
    _, p, turn = best
    published = np.isfinite(p).all(axis=1)
    p, q = p[published], grid.fit.q[published]
    residuals = locate_camera(Observations(p, q), camera).residuals
    good = np.hypot(*residuals.T) < 8 * np.median(np.hypot(*residuals.T))  # squares of markers are no dots
    view = Observations(p[good], q[good], source=name)
    return view, locate_camera(view, camera).rms_px, turn


if __name__ == "__main__":
    main()
