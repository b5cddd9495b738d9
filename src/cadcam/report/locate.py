"""A located part in words and tables: pose, uncertainty, evidence, and alternatives."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from cadcam.arrays import Array, significant
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.files.jsontext import Place, or_null
from cadcam.files.matrix import pose_as_json
from cadcam.files.pose_estimate import frames_as_json, pose_estimate_as_json, pose_estimate_at
from cadcam.geometry import rotation as so3
from cadcam.locate.location import FOUND, Location
from cadcam.locate.photo import Photo
from cadcam.report.table import Table

_SHOWN = 5  # alternatives in the table


def location_tables(location: Location, photos: Sequence[Photo], *, radius_mm: float) -> list[Table]:
    """Return pose with sigmas, evidence, and alternatives of a located part whose points lie within `radius_mm`."""
    tables = [pose_table(location.pose, photos[0], radius_mm=radius_mm), evidence_table(location)]
    if location.alternatives:
        tables.append(alternatives_table(location))
    return tables


def instances_table(instances: Sequence[Location], photo: Photo, *, radius_mm: float) -> Table:
    """Return a row for each instance of a part: its pose in the camera of a photo, its weakest motion, its quality."""
    rows = []
    for number, one in enumerate(instances, 1):
        camera_from_part = photo.camera_from_world @ one.pose.world_from_part
        at, turn = camera_from_part.translation, np.degrees(so3.log(camera_from_part.rotation))
        known = weakest(one.pose, radius_mm=radius_mm)
        rows.append((str(number), _three(at, 2), _three(turn, 2), known, f"{one.quality:.2f}"))
    columns = ("", "origin in the camera, mm", "rotation vector, deg", "weakest, sigma", "quality")
    notes = [f"{k}: {one.covered}" for k, one in enumerate(instances, 1) if one.covered]
    alike = max((len(one.alternatives) for one in instances), default=0)
    notes += [f"each may be in up to {alike} other poses, in which the part looks the same"] if alike else []
    return Table("Instances", columns, tuple(rows), columns[1:4], tuple(notes))


def pose_table(pose: PoseEstimate, photo: Photo, *, radius_mm: float) -> Table:
    """Return the pose of the part in the world and in the camera, and its uncertainty.

    The sigmas are those without what no photo can determine, which has a row of its own.
    """
    camera_from_part = photo.camera_from_world @ pose.world_from_part
    rows = [("part's origin in the camera, mm", _three(camera_from_part.translation, 3))]
    rows += [("rotation vector, camera from part, deg", _three(np.degrees(so3.log(camera_from_part.rotation)), 3))]
    if np.abs(photo.camera_from_world.matrix - np.eye(4)).max() > 0:
        rows.append(("part's origin in the world, mm", _three(pose.world_from_part.translation, 3)))
    rows += [*_sigmas(pose), ("weakest", weakest(pose, radius_mm=radius_mm)), *_undetermined(pose)]
    return Table("Pose", ("", ""), tuple(rows), ("",))


def world_table(pose: PoseEstimate) -> Table:
    """Return the pose of the part in the world, and its uncertainty, as `pose_table`."""
    part = pose.world_from_part
    rows = [("part's origin in the world, mm", _three(part.translation, 3))]
    rows += [("rotation vector, world from part, deg", _three(np.degrees(so3.log(part.rotation)), 3))]
    return Table("Pose", ("", ""), (*rows, *_sigmas(pose), *_undetermined(pose)), ("",))


def _sigmas(pose: PoseEstimate) -> list[tuple[str, str]]:
    known = pose.determined
    sigma = np.sqrt(np.diag(known.covariance))
    return [
        ("sigma along the part's x, y, z, mm", ", ".join(map(significant, sigma[:3]))),
        ("sigma of turns about them, deg", ", ".join(map(significant, np.degrees(sigma[3:])))),
        *_by_photo(known),
    ]


def _undetermined(pose: PoseEstimate) -> list[tuple[str, str]]:
    words = pose.undetermined_words
    return [("not determined", f"{words}: so turned, it looks the same")] if words else []


def _by_photo(pose: PoseEstimate) -> list[tuple[str, str]]:
    """Return the sigmas for a perfectly known camera, where the camera contributes to them."""
    if not pose.from_calibration.any():
        return []
    sigma = np.sqrt(np.diag(pose.from_noise))
    shift, turn = (", ".join(map(significant, part)) for part in (sigma[:3], np.degrees(sigma[3:])))
    return [("  by the photo alone, not the camera", f"{shift} mm; {turn} deg")]


def evidence_table(location: Location) -> Table:
    """Return the quality and its evidence."""
    used, rms = used_samples(location)
    rows = [("quality", f"{location.quality:.3f} (found from {FOUND} on)")]
    rows += [("places on edges", f"{used} of {len(location.matches)} fit")]
    rows += [("their distance from the photo's edges, rms", f"{rms:.2f} px")] if used else []
    rows += [("hidden", f"{location.covered}: they do not count")] if location.covered else []
    rows += [("why", location.reason)]
    return Table("Evidence", ("", ""), tuple(rows), ("",))


def alternatives_table(location: Location) -> Table:
    """Return the other poses that the photos allow: their rotations and shifts relative to this one."""
    rows = []
    for other in location.alternatives[:_SHOWN]:
        change = location.pose.world_from_part.inv @ other.pose.world_from_part
        turn = so3.log(change.rotation)
        angle = float(np.linalg.norm(turn))
        axis = _three(turn / angle, 2) if angle > 1e-6 else ""
        rows.append((f"{other.quality:.3f}", f"{np.degrees(angle):.1f}", axis, _three(change.translation, 1)))
    more = len(location.alternatives) - len(rows)
    notes = (f"and {more} more",) if more else ()
    columns = ("quality", "turned by deg", "about the part's axis", "moved by mm")
    return Table("It could also be", columns, tuple(rows), columns[1:], notes)


def weakest(pose: PoseEstimate, *, radius_mm: float) -> str:
    """Return the least certain motion, and its standard deviation; of those that photos can determine.

    Rotations count by the displacement at `radius_mm` from the part's origin, so that they compare with shifts.
    """
    pose = pose.determined
    if not pose.freedom.shape[1]:
        return "nothing else was free to move"
    scale = np.r_[np.ones(3), np.full(3, radius_mm)]
    values, vectors = np.linalg.eigh(pose.covariance * np.outer(scale, scale))
    sigma, v = float(np.sqrt(max(values[-1], 0.0))), vectors[:, -1]
    shift, turn = np.linalg.norm(v[:3]), np.linalg.norm(v[3:])
    if shift >= turn:
        return f"a shift along the part's ({_three(_signed(v[:3] / shift), 2)}), {significant(sigma)} mm"
    axis = _three(_signed(v[3:] / turn), 2)
    return f"a turn about the part's ({axis}), {significant(np.degrees(sigma / radius_mm))} deg"


def used_samples(location: Location) -> tuple[int, float]:
    """Return the number of edge samples used, and the rms of their distances in px (nan for none)."""
    m = location.matches
    used = m.believed
    return int(used.sum()), float(np.sqrt(np.mean(m.offset[used] ** 2))) if used.any() else float("nan")


def location_as_json(location: Location, photos: Sequence[Photo]) -> dict[str, Any]:
    """Return the result as JSON: the pose is under "pose", or under "best" where it is not accepted."""
    used, rms = used_samples(location)
    camera_from_part = photos[0].camera_from_world @ location.pose.world_from_part
    pose = pose_estimate_as_json(location.pose)
    return {
        "found": location.found,
        "quality": location.quality,
        "threshold": FOUND,
        "reason": location.reason,
        "pose": pose if location.found else None,
        **({} if location.found else {"best": pose}),
        "frames": frames_as_json([photo.viewpoint for photo in photos]),
        "disagreements": disagreements_as_json(location),
        "covered": asdict(location.covered) if location.covered else None,
        "camera_from_part": pose_as_json(camera_from_part),
        "edges": {
            "samples": len(location.matches),
            "used": used,
            "rms_px": rms if used else None,
            "off_px": location.off_px or None,  # as a whole, by more than light explains
        },
        "alternatives": [
            {"quality": other.quality, "world_from_part": pose_as_json(other.pose.world_from_part)}
            for other in location.alternatives
        ],
    }


def disagreements_as_json(location: Location) -> list[dict[str, Any]]:
    """Return which photos disagree with the common pose of the part: by how many px, and which was left out."""
    return [
        {"photo": one.photo, "name": one.name, "px": or_null(one.px), "left_out": one.left_out}
        for one in location.disagreements
    ]


def track_table(entries: Sequence[Mapping[str, Any]]) -> Table:
    """Return the summary of a track: frames found by each method, and where the part was lost."""
    ways = Counter(entry["how"] for entry in entries)
    found = [(entry["quality"], _sigma_mm(entry)) for entry in entries if entry["found"]]
    rows = [("frames", str(len(entries))), ("found", f"{len(found)}")]
    rows += [(f"  {how}", str(count)) for how, count in ways.items() if how != "lost"]
    if found:
        quality, sigma = np.median(found, axis=0)
        rows.append(("median quality", f"{quality:.3f}"))
        rows.append(("median sigma of the place, mm", significant(float(sigma))))
    lost = lost_stretches(entries)
    notes = ("lost: " + ", ".join(f"{a}" if a == b else f"{a} to {b}" for a, b in lost),) if lost else ()
    return Table("Tracked", ("", ""), tuple(rows), ("",), notes)


def _sigma_mm(entry: Mapping[str, Any]) -> float:
    """Return the standard deviation (mm) of the part's place in a frame, without turns that no photo shows."""
    pose = pose_estimate_at(Place(f"frame {entry['frame']}", ("pose",), entry["pose"]))
    return float(np.linalg.norm(pose.determined.sigma_mm))


def lost_stretches(entries: Sequence[Mapping[str, Any]]) -> list[tuple[int, int]]:
    """Return first and last frame of each stretch in which the part was lost."""
    out: list[tuple[int, int]] = []
    for entry in entries:
        if entry["found"]:
            continue
        if out and out[-1][1] == entry["frame"] - 1:
            out[-1] = (out[-1][0], entry["frame"])
        else:
            out.append((entry["frame"], entry["frame"]))
    return out


def _three(v: Array, digits: int) -> str:
    return ", ".join(f"{x:.{digits}f}" for x in np.round(v, digits) + 0.0)  # + 0.0: no -0.00


def _signed(v: Array) -> Array:
    """Return a direction with its largest component positive."""
    return np.asarray(v * np.sign(v[np.argmax(np.abs(v))]))
