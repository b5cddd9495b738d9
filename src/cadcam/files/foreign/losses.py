"""What a format cannot hold of a camera: found before anything is written, in words and in pixels."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace

import numpy as np

from cadcam.camera.camera import Camera
from cadcam.camera.difference import largest_difference
from cadcam.camera.equivalent import equivalents
from cadcam.camera.lens import LENSES, Ideal, Lens
from cadcam.errors import CadcamError, NotConverged
from cadcam.files.foreign.model import ConversionLoss, Holder, Holds, NamedCamera
from cadcam.fit.lens import Refit, refitted


class RefusedLoss(CadcamError):
    """A format cannot hold this camera, and the loss was not allowed."""

    def __init__(self, title: str, losses: Collection[ConversionLoss], *, can_fit: bool) -> None:
        names = ",".join(sorted({loss.what for loss in losses}))
        fit = "; or fit its nearest lens: --fit (fit=True)" if can_fit else ""
        super().__init__(
            f"{title} cannot hold all of this camera: {'; '.join(str(loss) for loss in losses)}; accept it with "
            f"--allow-loss {names} (allow_loss={tuple(names.split(','))}){fit}"
        )
        self.losses: tuple[ConversionLoss, ...] = tuple(losses)


def prepared(named: NamedCamera, form: Holder, *, fit: bool) -> tuple[NamedCamera, list[ConversionLoss]]:
    """Return the camera as the format can hold it, and the losses; these are not judged here."""
    camera, losses = _with_lens(named.camera, form.holds, fit=fit)
    for what, step, said in _STEPS:
        after = step(camera, form.holds)
        if after is not camera:
            losses.append(ConversionLoss(what, said(camera), largest_difference(camera, after)))
        camera = after
    if camera.skew and form.holds.skew == "ignored":
        said_skew = f"K01 = {camera.skew:.6g} px is written, but {form.title} itself ignores it"
        losses.append(ConversionLoss("skew", said_skew, largest_difference(camera, _skewless(camera))))
    pose = named.camera_from_world
    if pose is not None and form.holds.pose == "no":
        losses.append(ConversionLoss("pose", "where the camera stands is not kept"))
        pose = None
    if named.estimate is not None and not form.holds.estimate:
        n = len(named.estimate.observations)
        losses.append(
            ConversionLoss("covariance", f"sigmas, covariance and the {n} observations behind them are not kept")
        )
    if not form.holds.size:
        losses.append(ConversionLoss("size", f"the picture's size, {camera.width} x {camera.height} px, is not kept"))
    out = NamedCamera(named.name, camera, pose, named.estimate if form.holds.estimate else None)
    return out, [*losses, *form.extra_losses(out)]


def refuse(losses: Collection[ConversionLoss], allowed: Collection[str], title: str, *, can_fit: bool) -> None:
    """Raise `RefusedLoss` if a loss moves pixels and is not among those allowed ("all" allows any)."""
    refused = [loss for loss in losses if loss.moves_pixels and loss.what not in allowed]
    if refused and "all" not in allowed:
        raise RefusedLoss(title, refused, can_fit=can_fit and any(loss.what == "lens" for loss in refused))


def fits(lens: Lens, holds: Holds) -> bool:
    """Return whether a format can hold every coefficient of this lens that is not zero."""
    terms = holds.lenses.get(lens.name)
    return terms is not None and all(not value or name in terms for name, value in lens.parameters.items())


def _with_lens(camera: Camera, holds: Holds, *, fit: bool) -> tuple[Camera, list[ConversionLoss]]:
    for same in equivalents(camera):
        if fits(same.lens, holds):
            return same, []
    if not fit:
        less = replace(camera, lens=_less(camera.lens, holds))
        return less, [ConversionLoss("lens", _said_of(camera.lens, less.lens), largest_difference(camera, less))]
    best = _nearest(camera, holds)
    text = f"{_words(camera.lens)} becomes {_words(best.camera.lens)}, rms {best.rms_px:.3g} px"
    return best.camera, [ConversionLoss("fitted lens", text, best.max_px)]


def _said_of(lens: Lens, left: Lens) -> str:
    if isinstance(left, Ideal):
        return f"{_words(lens)} is dropped"
    lost = [f"{name} {value:.4g}" for name, value in lens.parameters.items() if value != left.parameters[name]]
    return f"{', '.join(lost)} of {_words(lens)} {'is' if len(lost) == 1 else 'are'} dropped"


def _words(lens: Lens) -> str:
    terms = ", ".join(f"{name} {value:.4g}" for name, value in lens.parameters.items() if value)
    return f"{lens.name} ({terms})" if terms else lens.name


def _less(lens: Lens, holds: Holds) -> Lens:
    """Return the lens without the terms that the format cannot hold."""
    terms = holds.lenses.get(lens.name, ())
    kept = {name: value for name, value in lens.parameters.items() if name in terms}
    return LENSES[lens.name](**kept) if any(kept.values()) else Ideal()


# kept at zero: they are meant for prisms and tilts, not to imitate other lenses
_NOT_FITTED = ("s1", "s2", "s3", "s4", "tau_x", "tau_y")


def _nearest(camera: Camera, holds: Holds) -> Refit:
    found = []
    for model, terms in holds.lenses.items():
        try:
            found.append(refitted(camera, model, [term for term in terms if term not in _NOT_FITTED]))
        except NotConverged:
            continue
    if not found:
        raise NotConverged(f"no lens of this format images the picture of {camera}")
    return min(found, key=lambda refit: refit.rms_px)


def _skewless(camera: Camera) -> Camera:
    K = camera.K.copy()
    K[0, 1] = 0.0
    return replace(camera, K=K)


def _without_skew(camera: Camera, holds: Holds) -> Camera:
    return _skewless(camera) if camera.skew and holds.skew == "no" else camera


def _with_square_pixels(camera: Camera, holds: Holds) -> Camera:
    if holds.aspect or camera.fx == camera.fy:
        return camera
    K = camera.K.copy()
    K[0, 0] = K[1, 1] = np.sqrt(camera.fx * camera.fy)
    return replace(camera, K=K)


def _centred(camera: Camera, holds: Holds) -> Camera:
    middle = ((camera.width - 1) / 2, (camera.height - 1) / 2)
    if holds.principal_point or np.array_equal(camera.principal_point, middle):
        return camera
    K = camera.K.copy()
    K[:2, 2] = middle
    return replace(camera, K=K)


_STEPS: tuple[tuple[str, Callable[[Camera, Holds], Camera], Callable[[Camera], str]], ...] = (
    ("skew", _without_skew, lambda c: f"K01 = {c.skew:.6g} px is dropped"),
    ("aspect", _with_square_pixels, lambda c: f"fx {c.fx:.6g} and fy {c.fy:.6g} px become their geometric mean"),
    ("principal-point", _centred, lambda c: f"({c.K[0, 2]:.6g}, {c.K[1, 2]:.6g}) px becomes the picture's centre"),
)
