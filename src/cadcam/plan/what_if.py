"""What if: the chosen cameras with another lens, distance, noise or calibration, or with one of them lost."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from cadcam.arrays import Array
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.optics import STANDARD_MM
from cadcam.errors import CadcamError
from cadcam.kinds import expect, expect_callable
from cadcam.plan.assessment.assess import Assessment, Outcome, assess
from cadcam.plan.layout import Layout
from cadcam.plan.scene.layout_scene import CalibratedFrom, CameraType, LayoutScene, Mount, Sigmas
from cadcam.plan.sight.candidate import Candidate, Placing
from cadcam.plan.sight.visibility import Visibility, seen_from
from cadcam.plan.uncertainty.finding import Finder

_NEARER, _FARTHER = 0.8, 1.25


@dataclass(frozen=True, slots=True)
class WhatIf:
    """One change, and what the chosen cameras measure with it: the worst ratio, limits by outcome; or why it cannot."""

    change: str
    worst: float = 0.0
    suitable: int = 0
    marginal: int = 0
    failed: int = 0
    impossible: str = ""


def what_if(layout: Layout, *, step: Callable[[], None] | None = None) -> tuple[WhatIf, ...]:
    """Return the table, the layout as planned first. The cameras stay in place unless the distance is changed.

    step: called after each change, for a progress display.
    """
    expect(layout, "layout", Layout)
    expect_callable(step, "step", optional=True)
    scene = layout.survey.scene
    out = [_said(layout, "as planned", layout.assessment)]
    if len(layout.chosen) > 1:
        for i, camera in enumerate(layout.cameras):
            rest = [c for c in layout.chosen if c != layout.chosen[i]]
            out.append(_said(layout, f"without {camera.name}", layout.survey.assess(rest)))
    for change, changed, stretch in _changes(scene, layout.cameras):
        try:
            cameras = rebuilt(changed, layout.cameras, stretch=stretch)
            out.append(_said(layout, change, _assessed(layout, changed, cameras)))
        except CadcamError as error:
            out.append(WhatIf(change, impossible=str(error)))
        if step:
            step()
    return tuple(out)


def _changes(scene: LayoutScene, cameras: Sequence[Candidate]) -> Iterator[tuple[str, LayoutScene, float]]:
    """Yield each change in words, the scene with it, and the relative change of the cameras' distances."""
    used = {c.type.name for c in cameras}
    for word, index in (("shorter", -1), ("longer", 0)):
        types = {name: _other_lens(kind, index) if name in used else kind for name, kind in scene.cameras.items()}
        said = ", ".join(
            sorted({f"{t.focal_mm:g} mm" for n, t in types.items() if n in used and t is not scene.cameras[n]})
        )
        if said:
            yield f"next {word} lens ({said})", replace(scene, cameras=types), 1.0
    yield f"{_NEARER:g} of the distance", scene, _NEARER
    yield f"{_FARTHER:g} times the distance", scene, _FARTHER
    yield "half the noise", replace(scene, finder=_noisier(scene.finder, 0.5)), 1.0
    yield "twice the noise", replace(scene, finder=_noisier(scene.finder, 2.0)), 1.0
    if scene.calibration != Sigmas() or any(c.type.estimate is not None for c in cameras):
        perfect = {name: replace(kind, estimate=None) for name, kind in scene.cameras.items()}
        yield "a perfect calibration", replace(scene, calibration=Sigmas(), cameras=perfect), 1.0
        assumed, worse = _worse_calibrated(scene.calibration), _worse_known(scene.cameras)
        yield "a calibration half as good", replace(scene, calibration=assumed, cameras=worse), 1.0
    if scene.motion != Sigmas() and any(c.shared for c in cameras):
        yield "motions known half as well", replace(scene, motion=_worse(scene.motion)), 1.0


def rebuilt(scene: LayoutScene, cameras: Sequence[Candidate], *, stretch: float = 1.0) -> tuple[Candidate, ...]:
    """Return the cameras with the types and assumptions of a scene, moved along their axes to or from their aims.

    One that is moved about is calibrated at the first place of its mount, chosen or not, as `candidates` has it.
    """
    mounts, placing = {mount.name: mount for mount in scene.mounts}, Placing(scene)

    def placed(name: str, mount: Mount, kind: str, eye: Array, aim: Array) -> Candidate:
        return placing.candidate(name, mount, scene.cameras[kind], aim + stretch * (eye - aim), aim)

    for mount, kind in dict.fromkeys((c.mount, c.type.name) for c in cameras):
        placed(mount, mounts[mount], kind, mounts[mount].eyes[0], mounts[mount].aims[0])
    return tuple(placed(c.name, mounts[c.mount], c.type.name, c.eye, c.aim) for c in cameras)


def looks_of(layout: Layout, scene: LayoutScene, cameras: Sequence[Candidate]) -> tuple[Visibility, ...]:
    """Return what some cameras see in the surroundings of a layout."""
    seen = layout.survey
    return tuple(
        seen_from(
            c.viewpoint,
            c.optics,
            seen.places,
            seen.poses,
            seen.surroundings,
            finder=scene.finder,
            seeing=scene.seeing,
            judging=seen.judging,
        )
        for c in cameras
    )


def _assessed(layout: Layout, scene: LayoutScene, cameras: Sequence[Candidate]) -> Assessment:
    seen = layout.survey
    return assess(cameras, looks_of(layout, scene, cameras), seen.places, seen.poses, seen.asked)


def _said(layout: Layout, change: str, found: Assessment) -> WhatIf:
    outcomes = found.outcomes(layout.survey.scene.tur)
    suitable, marginal = (outcomes.count(o) for o in (Outcome.SUITABLE, Outcome.MARGINAL))
    return WhatIf(change, found.worst, suitable, marginal, len(outcomes) - suitable - marginal)


def _other_lens(kind: CameraType, index: int) -> CameraType:
    """Return the type with the next shorter (-1) or longer (0) focal length on offer; itself if there is none."""
    if kind.own is not None or kind.focal_mm is None:
        return kind
    f = kind.focal_mm
    offered = [s for s in STANDARD_MM if (s < f * (1 - 1e-9) if index else s > f * (1 + 1e-9))]
    return replace(kind, focal_mm=offered[index]) if offered else kind


def _noisier(finder: Finder, times: float) -> Finder:
    return replace(
        finder,
        sigma_px=None if finder.sigma_px is None else times * finder.sigma_px,
        gray=None if finder.gray is None else times * finder.gray,
    )


def _worse(sigmas: Sigmas) -> Sigmas:
    return Sigmas(*(2 * getattr(sigmas, name) for name in Sigmas.__slots__))


def _worse_known(cameras: Mapping[str, CameraType]) -> dict[str, CameraType]:
    """Return the types with their own calibrations, of those that have one, half as good, shared as they were."""
    known = {id(kind.estimate): kind.estimate for kind in cameras.values() if kind.estimate is not None}
    worse = {key: _half_as_good(estimate) for key, estimate in known.items()}
    return {name: replace(kind, estimate=worse.get(id(kind.estimate))) for name, kind in cameras.items()}


def _half_as_good(estimate: CameraEstimate) -> CameraEstimate:
    """Return an estimate with twice the standard deviations, also where its errors are shared with others."""
    errors = tuple((source, 2 * D) for source, D in estimate.errors)
    return replace(estimate, cofactor=4 * estimate.cofactor, errors=errors)


def _worse_calibrated(assumed: Sigmas | CalibratedFrom) -> Sigmas | CalibratedFrom:
    if isinstance(assumed, Sigmas):
        return _worse(assumed)
    return CalibratedFrom(assumed.points, 2 * assumed.sigma_px, 2 * assumed.points_mm)
