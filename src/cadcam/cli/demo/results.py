"""The results of the demo beside the truth: one table per step, and the same as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cadcam.camera.estimate import CameraEstimate
from cadcam.report.table import Table, with_sigma

Said = dict[str, Any]


def bench_table(folder: Path, said: Sequence[Said]) -> Table:
    """Return the bench's camera beside the values printed in the dissertation."""
    from cadcam.calibrate.points.camera import calibrate_camera
    from cadcam.cli.demo.inputs import PRINTED
    from cadcam.files.points import read_points
    from cadcam.report.camera import compared

    estimate = _estimate(folder / "bench_camera.json")
    linear = calibrate_camera(read_points(folder / "bench_points.csv"), estimate.camera.size, method="dlt-c23")
    return compared(
        "1. The dissertation's camera, from the sixteen points of its Table 2.3",
        estimate,
        {"DLT, C23 = 1": linear, "as printed": PRINTED},
        notes=("the printed values are those of the direct linear transform with C23 = 1 (Table 2.9)",),
    )


def block_table(folder: Path, said: Sequence[Said]) -> Table:
    """Return the camera of the photo beside the true one."""
    from cadcam.camera.extended_pinhole import NAMES, ExtendedPinhole
    from cadcam.cli.demo.inputs import TRUE_CAMERA, TRUE_POSE
    from cadcam.report.camera import against_truth

    values = ExtendedPinhole.from_camera(TRUE_CAMERA, TRUE_POSE).vector.tolist()
    distance = _edge_distance(said)
    share = 100 * distance["share_within_2_px"]
    return against_truth(
        "2. The camera of the synthetic photo, from 24 corners picked to 0.3 px",
        _estimate(folder / "camera.json"),
        dict(zip(NAMES, values, strict=True)) | TRUE_CAMERA.lens.parameters,
        notes=(f"visible lines to the photo's edges: median {distance['median']:.2f} px, {share:.0f} % within 2 px",),
    )


def verdict_table(folder: Path, said: Sequence[Said]) -> Table:
    """Return the pose of the block and the judgements, beside the truth."""
    from cadcam.cli.demo.as_built import CLOSE_POSE, start_off

    verdict = said[-1]
    p, sigma = _camera_in_part(folder)
    rows: list[tuple[str, ...]] = []
    for axis, value, spread, true in zip("XYZ", p, sigma, CLOSE_POSE.origin, strict=True):
        rows.append((f"camera, {axis}", *_beside(value, spread, true), "mm", ""))
    rows += [_judged_row(j) for j in verdict["judgements"]]
    moved, turned = start_off()
    notes = (
        f"found from a start {moved:.0f} mm and {turned:.1f} deg off; the limits are those of tolerances.yaml",
        f"{verdict['reason']} (U = 2 sigma)",
        *_others(verdict["features"]),
        f"`cadcam verify` ends with exit code 1 for FAIL; all that it measured: {folder / 'report.html'}",
    )
    columns = ("", "measured", "sigma", "truth", "error/sigma", "unit", "verdict")
    title = f"3. The block as it was built, found in a photo and judged by its CAD: {verdict['verdict_in_full']}"
    return Table(title, columns, tuple(rows), ("", "sigma", "unit", "verdict"), notes)


def file_table(files: Mapping[str, str]) -> Table:
    """Return the files with their descriptions."""
    note = "run the commands above again, or with your own files"
    return Table("Files", ("file", "what it is"), tuple(files.items()), ("file", "what it is"), (note,))


def as_json(folder: Path, said: Sequence[Sequence[Said]]) -> Said:
    """Return all results, with the truth."""
    from cadcam.cli.demo.as_built import CLOSE_POSE, DISPLACED, DISPLACED_BY, FORGOTTEN
    from cadcam.cli.demo.inputs import TRUE_CAMERA, TRUE_POSE
    from cadcam.files.camera import parameters_as_json, pinhole_as_json
    from cadcam.files.matrix import pose_as_json

    bench, block = _estimate(folder / "bench_camera.json"), _estimate(folder / "camera.json")
    *_, located, verdict = said[-1]
    return {
        "bench": {"residual_px": bench.thesis_residual, "parameters": parameters_as_json(bench)},
        "block": {"residual_px": block.thesis_residual, "parameters": parameters_as_json(block)},
        "block_truth": pinhole_as_json(TRUE_CAMERA, TRUE_POSE) | TRUE_CAMERA.lens.parameters,
        "edge_distance_px": _edge_distance(said[1]),
        "located": located,
        "located_truth": {"camera_from_part": pose_as_json(CLOSE_POSE)},
        "verified": verdict,
        "verified_truth": {"displaced": {DISPLACED: list(DISPLACED_BY)}, "missing": [FORGOTTEN]},
    }


def draw_bench(folder: Path) -> None:
    """Draw the bench half as large again as its photo, with the targets' measured and projected positions."""
    from cadcam.cad.parts import calibration_bench
    from cadcam.cli.wires import scene_without_edges
    from cadcam.image.draw import draw_points
    from cadcam.image.picture import write_picture
    from cadcam.render import open_renderer
    from cadcam.render.view import Channel, Look

    estimate = _estimate(folder / "bench_camera.json")
    width, height = estimate.camera.size
    camera, pose = estimate.camera.resize((3 * width // 2, 3 * height // 2)), estimate.camera_from_world
    look = Look(supersampling=2, background=(0.86, 0.87, 0.88))
    renderer = open_renderer(scene_without_edges(calibration_bench()))
    picture = renderer.render(camera, pose, channels=Channel.IMAGE, look=look).image
    projected = camera.project(pose @ estimate.observations.p_world)
    measured = camera.pixel_of(estimate.camera.normalized(estimate.observations.q))
    picture = draw_points(picture, projected, color=(0.1, 0.7, 1.0), mark="circle", size=12, width=1.3)
    picture = draw_points(picture, measured, color=(1.0, 0.45, 0.0), mark="cross", size=12, width=1.3)
    write_picture(folder / "bench.png", picture)


def _estimate(path: Path) -> CameraEstimate:
    from cadcam.files.camera import read_camera

    estimate = read_camera(path).estimate
    assert estimate is not None  # just written
    return estimate


def _edge_distance(said: Sequence[Said]) -> dict[str, float]:
    found: dict[str, float] = next(s["edge_distance_px"] for s in said if s.get("edge_distance_px"))
    return found


def _camera_in_part(folder: Path) -> tuple[Sequence[float], Sequence[float]]:
    """Return the estimated position of the camera (3,) mm in the block's axes, and its standard deviations."""
    from cadcam.cli.demo.as_built import position_in_part
    from cadcam.files.jsontext import parsed
    from cadcam.files.pose_estimate import pose_estimate_at
    from cadcam.files.text import read_text

    path = folder / "pose.json"
    pose = pose_estimate_at(parsed(read_text(path)))  # the camera is the world
    p, sigma = position_in_part(pose.world_from_part, pose.covariance)
    return p.tolist(), sigma.tolist()


def _beside(value: float, sigma: float, true: float) -> tuple[str, str, str, str]:
    """Return value, sigma, truth and the error in sigmas, as text."""
    shown, spread = with_sigma(value, sigma)
    decimals = len(shown.partition(".")[2])
    shown = f"{round(value, decimals) + 0.0:.{decimals}f}"  # no -0.00
    return shown, f"+- {spread}", f"{true:.{decimals}f}", f"{round((value - true) / sigma, 1) + 0.0:+.1f}"


def _judged_row(judged: Said) -> tuple[str, ...]:
    from cadcam.cli.demo.as_built import true_position

    name, true = judged["feature"], true_position(judged["feature"])
    if judged["kind"] == "presence":
        return name, "missing" if judged["verdict"] == "FAIL" else "there", "", "forgotten", "", "", judged["verdict"]
    if judged["deviation_mm"] is None:
        return name, "not told", "", f"{true:.2f}", "", "mm", judged["verdict"]
    sigma = judged["expanded_uncertainty_mm"] / judged["k"]
    said = f"{judged['verdict']}: limit {judged['limit_mm']:g} mm"
    return f"{name}, along y", *_beside(judged["deviation_mm"], sigma, true), "mm", said


def _others(features: Sequence[Said]) -> list[str]:
    """Return the outcome for the bodies without a tolerance; all of them are in place in truth."""
    others = [f for f in features if f["role"] != "judged" and f["state"] != "out of view"]
    placed = sum(f["state"] == "in place" for f in others)
    said = [f"of {len(others)} other bodies in view, all as drawn in truth, {placed} are found in place"]
    return said + [f"{f['name']} is {f['state']}{_why(f)}" for f in others if f["state"] != "in place"]


def _why(feature: Said) -> str:
    return f" ({feature['why']})" if "why" in feature else ""
