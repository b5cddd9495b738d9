"""Hand-eye calibration compared with OpenCV: errors on simulated cells with exact truth, CPU time, and real sets.

    python benchmarks/handeye.py                     simulated cells only
    python benchmarks/handeye.py ../shared/data      and the real sets found there

Prints markdown: docs/benchmarks/handeye.md and docs/benchmarks/real_handeye.md keep it. OpenCV before 5 has
calibrateHandEye and calibrateRobotWorldHandEye (opencv-python-headless<5); with a later one its rows are left out, and
without any the two sets of pictures too, whose corners it finds. It is given the target's poses by its own solvePnP, as
its documentation has it, and cadcam the same pixels. CPU time is of everything from pixels on, both cores counted.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import re
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cadcam.arrays import Array
from cadcam.calibrate.handeye.adjustment import calibrate_hand_eye, calibrate_hand_eye_from_poses, target_poses
from cadcam.calibrate.handeye.estimate import HandEyeEstimate, Mounting
from cadcam.camera.camera import Camera
from cadcam.camera.observations import Observations
from cadcam.errors import CadcamError
from cadcam.files.robot_poses import read_robot_poses
from cadcam.fit.hand_eye import motions, park_martin
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

CELLS, POSES = 20, 30
ROBOTS = {"exact robot": (0.0, 0.0), "0.1 mm, 0.02 deg": (0.1, 0.00035), "0.5 mm, 0.06 deg": (0.5, 0.001)}
HAND_EYE = ("TSAI", "PARK", "HORAUD", "ANDREFF", "DANIILIDIS")
ROBOT_WORLD = ("SHAH", "LI")
SETS = ("moveit_handeye", "visp_franka_eye_in_hand", "visp_franka_eye_to_hand")


@dataclass(frozen=True)
class Answer:
    """Where the camera sits (mount_from_camera) and where the target stands, by one method."""

    camera: Rigid
    target: Rigid | None = None
    note: str = ""


def opencv() -> Any:
    """Return cv2, or None, with a line that says so where its hand-eye calibration is missing."""
    try:
        import cv2
    except ImportError:
        print("OpenCV is not installed: left out\n")
        return None
    if not hasattr(cv2, "calibrateHandEye"):
        print(f"OpenCV {cv2.__version__} has no calibrateHandEye (before 5 it has): its rows are left out\n")
    return cv2


def robots() -> Any:
    """Return the simulator of the tests."""
    path = Path(__file__).resolve().parents[1] / "tests/calibrate/robots.py"
    spec = importlib.util.spec_from_file_location("robots", path)
    if spec is None or spec.loader is None:
        sys.exit(f"{path} is missing: run from a source checkout")
    module = importlib.util.module_from_spec(spec)
    sys.modules["robots"] = module
    spec.loader.exec_module(module)
    return module


def camera_in(estimate: HandEyeEstimate) -> Answer:
    held = estimate.mounting == "eye-in-hand"
    pair = (estimate.flange_from_held, estimate.base_from_fixed)
    return Answer(pair[0 if held else 1], pair[1 if held else 0])


def ours(B: Rigid, seen: Sequence[Observations], camera: Camera, mounting: Mounting) -> Answer:
    return camera_in(calibrate_hand_eye(B, seen, camera, mounting=mounting))


def ours_closed_form(B: Rigid, seen: Sequence[Observations], camera: Camera, mounting: Mounting) -> Answer:
    C = target_poses(seen, camera)
    if mounting == "eye-in-hand":
        return Answer(park_martin(*motions(B, C)))
    return Answer(park_martin(*motions(B.inv, C)))


def peers(cv2: Any) -> dict[str, Callable[[Rigid, Rigid], Rigid]]:
    """Return OpenCV's methods: (world_from_mount, camera_from_target) -> mount_from_camera. None where it has none."""
    if not hasattr(cv2, "calibrateHandEye"):
        return {}

    def hand_eye(flag: int) -> Callable[[Rigid, Rigid], Rigid]:
        def solve(G: Rigid, C: Rigid) -> Rigid:
            R, t = cv2.calibrateHandEye(
                list(G.rotation), list(G.translation), list(C.rotation), list(C.translation), method=flag
            )
            return rounded(R, t)

        return solve

    def robot_world(flag: int) -> Callable[[Rigid, Rigid], Rigid]:
        def solve(G: Rigid, C: Rigid) -> Rigid:
            F = G.inv
            *_, R, t = cv2.calibrateRobotWorldHandEye(
                list(C.rotation), list(C.translation), list(F.rotation), list(F.translation), method=flag
            )
            return rounded(R, t).inv

        return solve

    found = {f"OpenCV {n.title()}": hand_eye(getattr(cv2, f"CALIB_HAND_EYE_{n}")) for n in HAND_EYE}
    names = {n: getattr(cv2, f"CALIB_ROBOT_WORLD_HAND_EYE_{n}") for n in ROBOT_WORLD}
    return found | {f"OpenCV {n.title()} (AX = ZB)": robot_world(flag) for n, flag in names.items()}


def rounded(R: Array, t: Array) -> Rigid:
    """Return a peer's answer, its rotation made one where it is not quite; one that is mirrored stays an error."""
    if np.linalg.det(R) <= 0 or not np.isfinite(R).all():
        raise ValueError("det(R) < 0: no rotation")
    return Rigid(so3.nearest(R), np.asarray(t).ravel())


def solved_poses(cv2: Any, seen: Sequence[Observations], camera: Camera) -> Rigid:
    """Return camera_from_target by OpenCV's solvePnP, each picture by itself; a tag by the method for squares."""
    poses = []
    for o in seen:
        flag = cv2.SOLVEPNP_IPPE_SQUARE if len(o) == 4 else cv2.SOLVEPNP_ITERATIVE
        _, r, t = cv2.solvePnP(o.p_world, o.q, camera.K, None, flags=flag)
        poses.append(Rigid(so3.exp(r.ravel()), t.ravel()).matrix)
    return Rigid.from_matrix(np.stack(poses))


def methods(cv2: Any) -> dict[str, Callable[[Rigid, Sequence[Observations], Camera, Mounting], Answer]]:
    """Return every method from pixels on."""
    found: dict[str, Callable[[Rigid, Sequence[Observations], Camera, Mounting], Answer]] = {
        "cadcam": ours,
        "cadcam, closed form alone": ours_closed_form,
    }
    for name, solve in peers(cv2).items():

        def run(
            B: Rigid,
            seen: Sequence[Observations],
            camera: Camera,
            mounting: Mounting,
            solve: Callable[[Rigid, Rigid], Rigid] = solve,
        ) -> Answer:
            return Answer(solve(B if mounting == "eye-in-hand" else B.inv, solved_poses(cv2, seen, camera)))

        found[name] = run
    return found


def simulated(cv2: Any) -> None:
    """Print errors and CPU time over simulated cells."""
    simulator = robots()
    print(
        f"{CELLS} cells a row, {POSES} poses, a board of 9 x 6 corners at 0.7 m, 1200 px focal length, 0.1 px of noise"
    )
    for mounting in ("eye-in-hand", "eye-to-hand"):
        for robot, noise in ROBOTS.items():
            rng = np.random.default_rng(1)
            cells = [simulator.cell(rng, POSES, mounting=mounting, robot=noise) for _ in range(CELLS)]
            print(f"\n### {mounting}, {robot}\n")
            print("| method | rms mm | rms deg | mm / cadcam's | CPU ms |\n|---|---|---|---|---|")
            best = np.nan
            for name, solve in methods(cv2).items():
                mm, deg, ms = errors(solve, cells)
                best = mm if name == "cadcam" else best
                print(f"| {name} | {mm:.3f} | {deg:.4f} | {mm / best:.1f} | {ms:.0f} |")


def errors(solve: Callable[..., Answer], cells: Sequence[Any]) -> tuple[float, float, float]:
    """Return rms of the camera's position (mm) and rotation (deg) and the median CPU time (ms)."""
    off, times = [], []
    for c in cells:
        start = time.process_time()
        found = solve(c.base_from_flange, c.observations, c.camera, c.mounting).camera
        times.append(time.process_time() - start)
        off.append((found.inv @ c.camera_pose).log())
    e = np.array(off)
    rms = [float(np.sqrt(np.mean(np.sum(e[:, part] ** 2, axis=1)))) for part in (slice(3), slice(3, 6))]
    return rms[0], float(np.degrees(rms[1])), 1e3 * float(np.median(times))


def one_axis(cv2: Any) -> None:
    """Print what becomes of motions about one axis only: nothing determines the camera's place along it."""
    simulator = robots()
    print("\n### turns about one axis only, 0.1 mm, 0.02 deg: 10 cells\n")
    print("| method | refused | largest error of what it returned, mm |\n|---|---|---|")
    rng = np.random.default_rng(2)
    cells = []
    for _ in range(10):
        C0 = simulator.target_poses(rng, 1, tilt=0.3)
        held, u = simulator.random_rigid(rng, 80), rng.normal(size=3)
        turn = Rigid(so3.exp(rng.uniform(-0.2, 0.2, (15, 1)) * u / np.linalg.norm(u)), rng.uniform(-20, 20, (15, 3)))
        C = held.inv @ (turn.inv @ (held @ Rigid(C0.rotation[0], C0.translation[0])))
        c = simulator.cell(rng, camera_from_target=C, robot=(0.1, 0.00035))
        cells.append((c, c.flange_from_held))
    for name, solve in methods(cv2).items():
        refused, worst = 0, 0.0
        for c, true in cells:
            try:
                found = solve(c.base_from_flange, c.observations, c.camera, "eye-in-hand").camera
            except (CadcamError, ValueError):
                refused += 1
                continue
            worst = max(worst, float(np.linalg.norm((found.inv @ true).log()[:3])))
        print(f"| {name} | {refused} of 10 | {f'{worst:.0f}' if refused < 10 else '-'} |")


def real(cv2: Any, data: Path) -> None:
    """Print the real sets: cadcam, OpenCV, published."""
    for name in SETS:
        if not (data / name).exists():
            print(f"{name} is not in {data}: left out\n")
            continue
        {"moveit_handeye": moveit}.get(name, franka)(cv2, data / name)


def moveit(cv2: Any, folder: Path) -> None:
    pairs = np.array(json.loads((folder / "pose_samples.json").read_text()))
    B, C = (Rigid(so3.nearest(M[:, :3, :3]), 1000 * M[:, :3, 3]) for M in (pairs[:, 0], pairs[:, 1]))
    x, y, z = (so3.exp(a * np.eye(3)[i]) for i, a in enumerate((0.230, -2.540, 1.950)))
    published = Rigid(x @ y @ z, np.array([659.0, -249.0, 830.0]))
    estimate = calibrate_hand_eye_from_poses(B, C, mounting="eye-to-hand")
    answers = {"cadcam": camera_in(estimate)}
    answers |= {n: attempt(s, B.inv, C) for n, s in peers(cv2).items()}
    print("## moveit_handeye: 50 poses, eye-to-hand, no pixels\n")
    table(estimate, answers | {"published": Answer(published)}, C)
    try:
        calibrate_hand_eye_from_poses(B, C, mounting="eye-in-hand")
    except CadcamError as error:
        print(f"\nRun as eye-in-hand, cadcam says: *{error}*\n")


def franka(cv2: Any, folder: Path) -> None:
    """Print one of ViSP's sets; its corners are found by OpenCV, so nothing without it."""
    if cv2 is None:
        print(f"{folder.name}: corners are found by OpenCV: left out\n")
        return
    mounting: Mounting = "eye-in-hand" if folder.name.endswith("in_hand") else "eye-to-hand"
    numbers = {k: float(v) for k, v in re.findall(r"<(px|py|u0|v0)>(.*?)<", (folder / "franka_camera.xml").read_text())}
    camera = Camera.from_focal((640, 480), numbers["px"], fy=numbers["py"], cx=numbers["u0"], cy=numbers["v0"])
    poses = [
        next(iter(read_robot_poses(folder / f"franka_pose_rPe_{i}.yaml", convention="ur").values()))
        for i in range(1, 9)
    ]
    B = Rigid.from_matrix(np.stack([p.matrix for p in poses]))
    seen = [found(cv2, cv2.imread(str(folder / f"franka_image-{i}.png"), 0), mounting) for i in range(1, 9)]
    estimate = calibrate_hand_eye(B, seen, camera, mounting=mounting)
    C = solved_poses(cv2, seen, camera)
    G = B if mounting == "eye-in-hand" else B.inv
    answers = {"cadcam": camera_in(estimate)} | {n: attempt(s, G, C) for n, s in peers(cv2).items()}
    print(f"## {folder.name}: 8 poses, {mounting}, {len(seen[0])} points a picture\n")
    table(estimate, answers, estimate.camera_from_target)
    if mounting == "eye-in-hand":
        print("\nPublished by ViSP: 0.456 deg, 5.41 mm.")
        resized(B, seen, camera, estimate)
    print()


def resized(B: Rigid, seen: Sequence[Observations], camera: Camera, estimate: HandEyeEstimate) -> None:
    """Print the same set with the target as large as the robot says that it is."""
    larger = [Observations(estimate.scale * o.p_world, o.q) for o in seen]
    again = calibrate_hand_eye(B, larger, camera, mounting="eye-in-hand")
    print(
        f"\nThe robot says that the board is {estimate.scale:.3f} +- {estimate.scale_sigma:.3f} times as large as "
        f"stated (squares of {23.6 * estimate.scale:.1f} mm, not 23.6). So large, the same pictures give:\n"
    )
    table(again, {"cadcam": camera_in(again)}, again.camera_from_target)


def found(cv2: Any, picture: Any, mounting: Mounting) -> Observations:
    """Return the chessboard's corners or the tag's, (column, row) from the centre of the first pixel."""
    if mounting == "eye-in-hand":
        _, corners = cv2.findChessboardCornersSB(picture, (9, 6))
        points = np.array([[23.6 * x, 23.6 * y, 0.0] for y in range(6) for x in range(9)])
        return Observations(points, corners.reshape(-1, 2).astype(np.float64))
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(picture)
    square = 24.0 * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    return Observations(square, corners[ids.ravel().tolist().index(10)].reshape(-1, 2).astype(np.float64))


def attempt(solve: Callable[[Rigid, Rigid], Rigid], G: Rigid, C: Rigid) -> Answer:
    try:
        return Answer(solve(G, C))
    except ValueError as error:
        return Answer(Rigid(), note=str(error))


def table(estimate: HandEyeEstimate, answers: dict[str, Answer], C: Rigid) -> None:
    """Print where each method puts the camera, and how well the target then stays in one place (ViSP's measure)."""
    noise, held = estimate.robot_noise, estimate.held_out
    print("| method | camera x, y, z mm | off cadcam's deg | target moves, rms deg | rms mm |\n|---|---|---|---|---|")
    mine = answers["cadcam"].camera
    for name, answer in answers.items():
        if answer.note:
            print(f"| {name} | {answer.note} | | | |")
            continue
        deg, mm = spread(estimate, answer.camera, C)
        x, y, z = answer.camera.translation
        off = float(np.degrees(np.linalg.norm(so3.log(mine.rotation.T @ answer.camera.rotation))))
        print(f"| {name} | {x:.1f}, {y:.1f}, {z:.1f} | {off:.2f} | {deg:.3f} | {mm:.2f} |")
    sigma = np.sqrt(np.diag(estimate.covariance_of_camera))
    print(
        f"\ncadcam's sigmas: {', '.join(f'{s:.2f}' for s in sigma[:3])} mm and "
        f"{', '.join(f'{s:.2f}' for s in np.degrees(sigma[3:]))} deg in camera axes; robot's noise "
        f"{noise.translation:.2g} +- {noise.translation_sigma:.1g} mm, {np.degrees(noise.rotation):.2g} +- "
        f"{np.degrees(noise.rotation_sigma):.1g} deg; held out {np.sqrt(np.mean(held.mm**2)):.2f} mm, "
        f"{np.degrees(np.sqrt(np.mean(held.rotation**2))):.2f} deg rms; scale {estimate.scale:.3f} +- "
        f"{estimate.scale_sigma:.3f}."
    )


def spread(estimate: HandEyeEstimate, camera: Rigid, C: Rigid) -> tuple[float, float]:
    """Return how far base_from_target (or flange_from_target) of each pose is from their mean, rms deg and mm."""
    B = estimate.base_from_flange if estimate.mounting == "eye-in-hand" else estimate.base_from_flange.inv
    every = B @ camera @ C
    R = so3.nearest(every.rotation.mean(axis=0))
    turn = np.linalg.norm(so3.log(R.T @ every.rotation), axis=1)
    shift = np.linalg.norm(every.translation - every.translation.mean(axis=0), axis=1)
    return float(np.degrees(np.sqrt(np.mean(turn**2)))), float(np.sqrt(np.mean(shift**2)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", nargs="?", type=Path, help="folder of the real sets")
    parser.add_argument("--real-only", action="store_true", help="leave the simulated cells out")
    arguments = parser.parse_args()
    cv2 = opencv()
    if not arguments.real_only:
        simulated(cv2)
        one_axis(cv2)
    if arguments.data is not None:
        print()
        real(cv2, arguments.data)


if __name__ == "__main__":
    main()
