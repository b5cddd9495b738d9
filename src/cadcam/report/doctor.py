"""The capabilities of this installation of cadcam on this machine: examined, never assumed, and never a crash.

A new check is a function that returns a `Finding`, and its line in `CHECKS`.
"""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

from cadcam import __version__
from cadcam.cores import usable_cores
from cadcam.errors import MissingCore, MissingOpenGL
from cadcam.report.table import Table

_RAYS = "the ray renderer, hidden lines"


@dataclass(frozen=True, slots=True)
class Finding:
    """The finding on one thing: `there` where it works, what it is or why it is not, and what to do for more."""

    topic: str
    there: bool
    found: str
    remedy: str = ""


def examine() -> list[Finding]:
    """Return a finding for each of `CHECKS`; a check that fails is a finding, too."""
    return [_guarded(topic, check) for topic, check in CHECKS.items()]


def doctor_table(findings: list[Finding]) -> Table:
    """Return the findings as a table, with the remedies below it."""
    rows = tuple((f.topic, "yes" if f.there else "no", f.found) for f in findings)
    more = tuple(f"{f.topic}: {f.remedy}" for f in findings if f.remedy)
    notes = ("for more:", *more) if more else ("nothing is missing",)
    columns = ("what", "there", "found")
    return Table(f"cadcam {__version__}", columns, rows, left=columns, notes=notes)


def _guarded(topic: str, check: Callable[[str], Finding]) -> Finding:
    try:
        return check(topic)
    except Exception as error:  # whatever a broken installation raises: reporting that is this module's task
        return Finding(topic, False, f"fails with {type(error).__name__}: {_one_line(error)}", "reinstall cadcam")


def _python(topic: str) -> Finding:
    found = f"{platform.python_version()} ({sys.executable}) on {platform.platform()}"
    return Finding(topic, True, found)


def _cpu(topic: str) -> Finding:
    there, usable = os.cpu_count() or 1, usable_cores()
    cores = f"{there} cores" if usable == there else f"{usable} of {there} cores may be used"
    return Finding(topic, True, f"{cores}, {platform.machine() or 'unknown machine'}")


def _core(topic: str) -> Finding:
    """Return whether the compiled core loads, and which instruction set it chose."""
    from cadcam.native.core import LIBRARY, variant

    try:
        return Finding(topic, True, f"{LIBRARY.name}, instruction set {variant()}")
    except MissingCore as error:
        remedy = "install a C compiler (or allow pip to fetch the ziglang wheel), then reinstall cadcam"
        return Finding(topic, False, error.why, remedy)


def _package(topic: str, *, name: str, module: str, gives: str, remedy: str) -> Finding:
    """Return whether a package can be imported, not only found: it may be half installed."""
    if find_spec(module) is None:
        return Finding(topic, False, f"{name} is not installed ({gives})", remedy)
    try:
        import_module(module)
    except Exception as error:
        return Finding(topic, False, f"{name} is installed but cannot be imported: {_one_line(error)}", remedy)
    try:
        number = version(name)
    except PackageNotFoundError:
        number = "of unknown version"
    return Finding(topic, True, f"{name} {number} ({gives})")


def _extra(extra: str, name: str, module: str, gives: str) -> Callable[[str], Finding]:
    return partial(_package, name=name, module=module, gives=gives, remedy=f'pip install "cadcam[{extra}]"')


def _caster(topic: str) -> Finding:
    """Return what casts rays: Embree, or without it the core."""
    found = _package(topic, name="embreex", module="embreex", gives=_RAYS, remedy="pip install embreex")
    if found.there or not _core(topic).there:
        return found
    wheels = sys.platform != "linux" or platform.machine() == "x86_64"
    remedy = "pip install embreex (casts rays several times as fast)" if wheels else ""
    return Finding(topic, True, f"the raster core ({_RAYS}); {found.found.split(' (')[0]}", remedy)


def _opengl(topic: str) -> Finding:
    """Return the description of OpenGL on EGL, queried in a process of its own."""
    from cadcam.render.gl.context import probe

    info = probe()
    if not info.available:
        return Finding(topic, False, info.reason, MissingOpenGL.REMEDY if find_spec("moderngl") else "")
    kind = "software" if info.software else "GPU"
    return Finding(topic, True, f"{info.renderer}, {info.version} ({kind}); the renderer gl, on request")


def _auto(topic: str) -> Finding:
    from cadcam.render import auto_choice

    name, why = auto_choice()
    return Finding(topic, True, f"{name}: {why}")


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:200]


CHECKS: dict[str, Callable[[str], Finding]] = {
    "Python": _python,
    "CPU": _cpu,
    "raster core": _core,
    "ray caster": _caster,
    "extra step": _extra("step", "cascadio", "cascadio", "STEP and IGES files"),
    "extra codecs": _extra("codecs", "imagecodecs", "imagecodecs", "LZW, JPEG ... inside TIFF"),
    "extra gl": _extra("gl", "moderngl", "moderngl", "the OpenGL renderer"),
    "extra postgresql": _extra("postgresql", "pg8000", "pg8000", "a store of product state in PostgreSQL"),
    "extra boards": _extra("boards", "opencv-python-headless", "cv2", "ChArUco boards"),
    "extra video": _extra("video", "opencv-python-headless", "cv2", "tracking in video files"),
    "extra cluster": _extra("cluster", "distributed", "distributed", "data sets made on a Dask cluster"),
    "extra plots": _extra("plots", "matplotlib", "matplotlib", "figures of a study"),
    "OpenGL": _opengl,
    'renderer "auto"': _auto,
}
