"""Calibrations of public data sets: ours, the published values, and what OpenCV gets, where it is installed.

    python benchmarks/real_calibrations.py ../shared/data

The folder holds the data sets as sub-folders, each as its authors published it; absent ones are left out. A new
set is a function that takes its folder and returns its section, put into `SETS`.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from cadcam.arrays import Array, Longs
from cadcam.calibrate.joint.adjustment import calibrate_jointly, fit_jointly
from cadcam.calibrate.joint.nested import nested_advice
from cadcam.calibrate.points.camera import calibrate_camera
from cadcam.camera.joint_estimate import JointEstimate
from cadcam.camera.lens import BrownConrady
from cadcam.camera.observations import Observations
from cadcam.errors import CadcamError
from cadcam.fit.dlt import dlt
from cadcam.fit.joint_start import homographies
from cadcam.report.table import with_sigma

ALL = ("k1", "k2", "p1", "p2", "k3")
_PX_BY_MM = 313.371  # of the chip that DBAT reports in mm


def zhang_planar(folder: Path) -> list[str]:
    X = 25.4 * np.loadtxt(folder / "Model.txt").reshape(-1, 2)
    X = np.column_stack([X, np.zeros(len(X))])
    pixels = [np.loadtxt(folder / f"data{i}.txt").reshape(-1, 2) for i in range(1, 6)]
    views = [Observations(X, q, source=f"data{i + 1}") for i, q in enumerate(pixels)]
    fit = fit_jointly(views, (640, 480), lens=BrownConrady(), free_lens=("k1", "k2"))
    found = calibrate_jointly(views, (640, 480), lens=BrownConrady(), free_lens=("k1", "k2"))
    published = [float(x) for x in (folder / "calibration-result-zhang-withdistortion.txt").read_text().split()[:7]]
    other = _opencv([X] * 5, pixels, (640, 480), held=("p1", "p2", "k3"))
    K, C = found.camera.K, _pixels(found)
    rows = []
    for i, (name, value) in enumerate(
        zip(("fx", "skew", "fy", "cx", "cy"), K[[0, 0, 1, 0, 1], [0, 1, 1, 2, 2]], strict=True)
    ):
        theirs = "not modelled" if name == "skew" else _value(other, ("fx", "", "fy", "cx", "cy")[i], value)
        rows.append((f"{name} px", *with_sigma(value, C[name]), _digits(published[i]), theirs))
    for i, name in enumerate(("k1", "k2")):
        sigma = found.sigma(name)
        rows.append(
            (name, *with_sigma(found.value(name), sigma), _digits(published[5 + i]), _value(other, name, sigma))
        )
    rows.append(("rms px", f"{found.rms_px:.4f}", "", "", _value(other, "rms", 1e-4)))
    advice = nested_advice(fit).recommendation
    bad = ", ".join(found.names[j] for j in found.outlier_views())
    return [
        "## Zhang's planar views (1998), 5 views of 256 points, skew estimated",
        *_table(("", "ours", "sigma", "published", "OpenCV (no skew)"), rows),
        f"Outlier views: {bad}. Nested models recommend: {advice}.",
    ]


def dbat_camcal(folder: Path) -> list[str]:
    """Return the section; the report is in mm on the chip, pixels from a corner, the signs of K and P turned."""
    views = _sheet(folder)
    free = {n for v in views for n in v.names} - {"1001", "1002", "1003", "1004"}
    found = calibrate_jointly(
        views,
        (2272, 1704),
        fixed={"skew": 0, "aspect": 1},
        lens=BrownConrady(),
        free_lens=ALL,
        control_sigma=dict.fromkeys(free, 1e4),
    )
    report = (folder / "dbatexports/camcal-dbatreport-model-1.txt").read_text()
    other = _opencv([v.p_world for v in views], [v.q for v in views], (2272, 1704), focal=2300.0)
    sigma0 = float(np.sqrt(found.sum_of_squares / 3726))
    rows = [*_beside_dbat(found, report, other), ("sigma0 px", f"{sigma0:.6f}", "", "0.162168", "", "")]
    return [
        "## A camera calibration sheet, 21 views of 100 dots, the dots' places estimated too (4 fixed)",
        *_table(("", "ours", "sigma", "published", "its sigma", "OpenCV (dots as published, guess given)"), rows),
        "Published by an independent bundle adjuster (DBAT 0.9.2), in mm; the sigmas of its K1 to P2 are without the "
        "focal length's share.",
    ]


def _beside_dbat(found: JointEstimate, report: str, other: dict[str, float]) -> list[tuple[str, ...]]:
    """Return the rows of parameters: ours, those of DBAT's report in our units, and OpenCV's."""
    f = found.value("focal") / _PX_BY_MM
    in_px = [("focal", "Camera Constant:", "fy", 0.0), ("V0", "px - principal", "cx", 0.5), ("U0", "py - ", "cy", 0.5)]
    in_mm = [
        ("k1", "K1 - radial", -(f**2)),
        ("k2", "K2 - radial", -(f**4)),
        ("k3", "K3 - radial", -(f**6)),
        ("p1", "P2 - decentering", f),
        ("p2", "P1 - decentering", -f),
    ]
    asked = [(name, title, column, f"{column} px", _PX_BY_MM, shift) for name, title, column, shift in in_px]
    asked += [(name, title, name, name, scale, 0.0) for name, title, scale in in_mm]
    rows: list[tuple[str, ...]] = []
    for name, title, column, label, scale, shift in asked:
        value, sigma = _reported(report, title)
        sd = found.sigma(name)
        ours, theirs = with_sigma(found.value(name), sd), with_sigma(scale * value - shift, abs(scale) * sigma)
        rows.append((label, *ours, *theirs, _value(other, column, sd)))
    return rows


def openptv_cavity(folder: Path) -> list[str]:
    """Return the section: four cameras on a two-level target in water, each alone, dots matched from four clicks."""
    rows = []
    for camera in range(4):
        dots = _dots(folder, camera)
        linear, found = calibrate_camera(dots, (1280, 1024), method="dlt"), calibrate_camera(dots, (1280, 1024))
        focal = " +- ".join(with_sigma(found.value("focal"), found.sigma("focal")))
        residuals = [f"{e.thesis_residual:.4f}" for e in (linear, found)]
        rows.append((f"camera {camera + 1}", f"{len(dots)} of 73", *residuals, focal))
    return [
        "## Four cameras on a two-level target of 73 dots in a water tank, each calibrated alone",
        *_table(("", "dots found", "linear transform px", "least squares px", "focal px"), rows),
        "Refraction makes the internals meaningless: the residuals (a point) are what counts. OpenCV cannot start on a "
        "field that is not flat without a guess.",
    ]


SETS: dict[str, Callable[[Path], list[str]]] = {
    "zhang_planar": zhang_planar,
    "dbat_camcal": dbat_camcal,
    "openptv_cavity": openptv_cavity,
}


def _sheet(folder: Path) -> list[Observations]:
    def rows(name: str, skip: int) -> list[list[str]]:
        lines = (folder / "pmexports" / name).read_text().splitlines()[skip:]
        return [row for row in csv.reader(lines) if len(row) > 6]

    points = {r[0]: [1e3 * float(x) for x in r[3:6]] for r in rows("weighted-with-orient-3dpts.txt", 5)}
    points |= {"1001": [0, 1e3, 0], "1002": [1e3, 1e3, 0], "1003": [0, 0, 0], "1004": [1e3, 0, 0]}
    seen = rows("weighted-with-orient-2dpts.txt", 4)
    views = []
    for photo in sorted({int(r[1]) for r in seen}):
        own = [r for r in seen if int(r[1]) == photo]
        q = np.array([[float(r[2]), float(r[3])] for r in own]) - 0.5
        p = np.array([points[r[0]] for r in own])
        views.append(Observations(p, q, tuple(r[0] for r in own), sigma_px=0.162168, source=f"photo {photo}"))
    return views


def _dots(folder: Path, camera: int) -> Observations:
    """Return the dots that are where the four clicked ones lead to look for them, as many as agree with one camera."""
    field = np.loadtxt(folder / "cal/target_on_a_side.txt")
    clicked = np.loadtxt(folder / "parameters/man_ori.dat").reshape(4, 4, 2)[camera]
    chosen = np.loadtxt(folder / "parameters/man_ori.par", dtype=int).reshape(4, 4)[camera]
    seen = np.loadtxt(folder / f"cal/cam{camera + 1}.tif_targets", skiprows=1)[:, 1:3]
    X = field[:, 1:]
    corners = X[[int(np.flatnonzero(field[:, 0] == i)[0]) for i in chosen]]
    H = homographies(corners[None, :, :2], clicked[None], np.ones((1, 4), dtype=bool))[0]
    flat = np.column_stack([H[:, :2], np.zeros(3), H[:, 2]])
    found = [_matched(X, seen, flat, reach, fall) for reach in (20.0, 30.0, 45.0) for fall in (2, 9)]
    dots, nearest = max(found, key=lambda m: len(m[0]))
    return Observations(
        X[dots], seen[nearest], tuple(str(int(i)) for i in field[dots, 0]), source=f"camera {camera + 1}"
    )


def _matched(X: Array, seen: Array, P: Array, reach: float, fall: int) -> tuple[Longs, Longs]:
    """Dots and their marks within reach of a camera matrix that is refitted to them, the reach falling to 3 px."""
    none = np.zeros(0, dtype=int)
    while True:
        q = np.column_stack([X, np.ones(len(X))]) @ P.T
        D = np.linalg.norm((q[:, :2] / q[:, 2:])[:, None] - seen, axis=2)
        nearest = D.argmin(axis=1)
        dots = np.flatnonzero((D.min(axis=1) < reach) & (D[:, nearest].argmin(axis=0) == np.arange(len(X))))
        if len(dots) < 8 or reach == 3.0:
            good = len(dots) >= 8 and np.sqrt(np.mean(D[dots, nearest[dots]] ** 2)) < 1
            return (dots, nearest[dots]) if good else (none, none)
        try:
            P = dlt(X[dots], seen[nearest[dots]])
        except CadcamError:
            return none, none
        reach = max(3.0, reach / fall)


def _reported(report: str, title: str) -> tuple[float, float]:
    """Return value and deviation under a title of the bundle adjuster's report."""
    lines = report[report.index(title) :].splitlines()[1:3]
    value, sigma = (float(line.split(":")[1].split()[0]) for line in lines)
    return value, sigma


def _pixels(found: JointEstimate) -> dict[str, float]:
    """Return the standard deviations of fx, skew, fy, cx, cy in px, from those of aspect, focal, skew, U0, V0."""
    aspect, focal, skew = (found.value(n) for n in ("aspect", "focal", "skew"))
    J = np.zeros((5, len(found.free)))
    place = {n: found.free.index(n) for n in ("aspect", "focal", "skew", "U0", "V0")}
    c, s = np.cos(skew), np.sin(skew)
    J[0, [place["aspect"], place["focal"], place["skew"]]] = focal * c, aspect * c, -focal * aspect * s
    J[1, [place["aspect"], place["focal"], place["skew"]]] = focal * s, aspect * s, focal * aspect * c
    J[2, place["focal"]] = J[3, place["V0"]] = J[4, place["U0"]] = 1.0
    sd = np.sqrt(np.diag(J @ found.covariance @ J.T))
    return dict(zip(("fx", "skew", "fy", "cx", "cy"), sd.tolist(), strict=True))


def _opencv(
    points: Sequence[np.ndarray],
    pixels: Sequence[np.ndarray],
    size: tuple[int, int],
    *,
    held: Iterable[str] = (),
    focal: float | None = None,
) -> dict[str, float]:
    """Return OpenCV's camera by name; empty where it is not installed. With a focal length to guess fx = fy."""
    try:
        import cv2
    except ImportError:
        return {}
    flags = cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_USE_INTRINSIC_GUESS if focal else 0
    flags |= cv2.CALIB_ZERO_TANGENT_DIST if "p1" in held else 0
    flags |= cv2.CALIB_FIX_K3 if "k3" in held else 0
    K = None if focal is None else np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1.0]])
    p, q = [x.astype(np.float32) for x in points], [x.astype(np.float32) for x in pixels]
    rms, K, d, *_ = cv2.calibrateCamera(p, q, size, K, None, flags=flags)
    values = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2], "rms": rms / np.sqrt(2)}
    return values | dict(zip(ALL, np.ravel(d)[:5].tolist(), strict=True))


def _value(values: dict[str, float], name: str, sigma: float) -> str:
    return with_sigma(values[name], abs(sigma) if abs(sigma) < 1 else 0.1)[0] if name in values else ""


def _digits(value: float) -> str:
    return f"{value:.6g}"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    lines = [" | ".join(head), " | ".join("---" for _ in head), *(" | ".join(row) for row in rows)]
    return ["", *(f"| {line} |" for line in lines), ""]


def main() -> None:
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    data = Path(sys.argv[1])
    print("# Calibrations of public data\n\nMade by `python benchmarks/real_calibrations.py ../shared/data`; the data")
    print("sets are not in this repository. Pixels (column, row), (0, 0) the centre of the top-left one; mm.")
    for name, section in SETS.items():
        if (data / name).is_dir():
            print("\n" + "\n".join(section(data / name)))


if __name__ == "__main__":
    main()
