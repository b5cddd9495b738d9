"""Keys of a scene file that would change nothing in that scene: refused, since whoever wrote them expects an effect."""

from __future__ import annotations

from collections.abc import Callable

from cadcam.files.jsontext import Place
from cadcam.plan.scene.feature import Kind
from cadcam.plan.scene.layout_scene import LayoutScene

_Rule = tuple[tuple[str, ...], Callable[[LayoutScene], bool], str, str]
_RULES: tuple[_Rule, ...] = (  # the key; whether it has an effect; why not; what would give it one
    (
        ("motion",),
        lambda scene: any(mount.one_camera for mount in scene.mounts),
        "says how well motions are known, but no camera is moved",
        "set one_camera: true at a mount",
    ),
    (
        ("placement",),
        lambda scene: any(feature.plane_mm is not None for feature in scene.features),
        "counts for features on known planes, and there are none",
        "give a feature known_plane_mm",
    ),
    *(
        (
            ("calibration", key),
            lambda scene: any(scene.cameras[kind].estimate is None for m in scene.mounts for kind in m.cameras),
            "is of cameras whose file states no calibration, and there are none",
            "give a camera without one",
        )
        for key in ("focal_px", "principal_point_px")
    ),
    (
        ("seen", "blur_px"),
        lambda scene: any(scene.cameras[kind].f_number is not None for m in scene.mounts for kind in m.cameras),
        "limits a blur that no camera has",
        "give a camera its f_number",
    ),
    (
        ("noise", "blur_px"),
        lambda scene: (
            scene.finder.by_gray
            or any(scene.cameras[kind].f_number is not None for m in scene.mounts for kind in m.cameras)
        ),
        "is a blur that no camera's defocus adds to, and sigma_px holds for it",
        "give a camera its f_number, or gray and contrast",
    ),
    *(
        (
            ("noise", key),
            lambda scene: any(feature.kind is not Kind.POINT for feature in scene.features),
            "tells how well circles and edges are found, and there are none",
            "give a circle_mm, an edge_mm or a part",
        )
        for key in ("gray", "contrast")
    ),
    *(
        (
            ("seen", key),
            lambda scene: any(feature.kind is not Kind.POINT for feature in scene.features),
            "is asked of circles and edges, and there are none",
            "give a circle_mm, an edge_mm or a part",
        )
        for key in ("least_px", "share")
    ),
)


def refuse_idle(place: Place, scene: LayoutScene) -> None:
    """Raise `UnreadableFile` naming a key in a scene's file that has no effect in this scene."""
    for keys, works, why, remedy in _RULES:
        at: Place | None = place
        for key in keys:
            at = at.at(key) if at is not None and key in at.object else None
        if at is not None and not works(scene):
            raise at.error(why, f"{remedy}, or leave it out")
