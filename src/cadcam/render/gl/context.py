"""OpenGL on EGL: the available devices, and the one context of a process, kept in a thread of its own.

The devices are queried in a child process first, so that a driver that prints, hangs or crashes does not take the
caller with it. The defaults can be overridden: the device by index or part of its name, with the argument `device` or
the environment variable CADCAM_GL_DEVICE; the libraries by CADCAM_LIBEGL and CADCAM_LIBGL (file names or paths).
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from typing import Any, TypeVar

from cadcam.errors import MissingExtra, MissingOpenGL, UnknownName
from cadcam.render.gl import probe as gl_probe

Result = TypeVar("Result")

_SOFTWARE = ("llvmpipe", "softpipe", "swiftshader", "swrast", "software rasterizer", "lavapipe")
_PATIENCE = 30.0  # s; the first start of a driver reads its cache from disc


@dataclass(frozen=True, slots=True)
class GlInfo:
    """The description of OpenGL on one EGL device; `reason` says why it is not available, in one line."""

    available: bool
    renderer: str = ""
    vendor: str = ""
    version: str = ""
    software: bool = False
    device: int = 0
    reason: str = ""


def probe(device: int | str | None = None) -> GlInfo:
    """Return the device that `GlRenderer` would use; never raises, prints or crashes.

    Without a device named here or in CADCAM_GL_DEVICE it is the first that is a GPU, else the first.
    """
    found = devices()
    answering = [info for info in found if info.available]
    if not answering:
        return found[0]
    wanted = os.environ.get("CADCAM_GL_DEVICE") if device is None else device
    if wanted is None or wanted == "":
        return next((info for info in answering if not info.software), answering[0])
    known = [f"{info.device} ({info.renderer})" for info in answering]
    text = str(wanted).strip().lower()
    for info in answering:
        if text == str(info.device) or (not text.isdigit() and text in f"{info.renderer} {info.vendor}".lower()):
            return info
    return GlInfo(False, reason=str(UnknownName("OpenGL device", str(wanted), known)))


def devices() -> tuple[GlInfo, ...]:
    """Return the description of each EGL device; at least one entry. Queried once per libraries, in a child process."""
    return _devices(os.environ.get("CADCAM_LIBEGL", ""), os.environ.get("CADCAM_LIBGL", ""))


@cache
def _devices(libegl: str, libgl: str) -> tuple[GlInfo, ...]:
    if find_spec("moderngl") is None:
        return (GlInfo(False, reason='the package moderngl is not installed: pip install "cadcam[gl]"'),)
    command = [sys.executable, "-P", gl_probe.__file__, libegl, libgl]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=_PATIENCE, check=False, stdin=subprocess.DEVNULL
        )
    except subprocess.TimeoutExpired:
        return (GlInfo(False, reason=f"EGL did not answer within {_PATIENCE:.0f} s"),)
    except OSError as error:
        return (GlInfo(False, reason=f"no process could be started to ask EGL: {error}"),)
    said = [_info(json.loads(line)) for line in done.stdout.splitlines() if line.startswith("{")]
    if done.returncode:
        how = f"signal {-done.returncode}" if done.returncode < 0 else f"exit status {done.returncode}"
        said.append(GlInfo(False, device=len(said), reason=f"the OpenGL driver ended its process with {how}"))
    return _useful(said)


def _useful(said: list[GlInfo]) -> tuple[GlInfo, ...]:
    """Leave out the failure that only means that there are no more devices."""
    if any(info.available for info in said):
        said = [info for info in said if info.available or "found" not in info.reason]
    return tuple(said) or (GlInfo(False, reason="EGL knows no device"),)


def _info(said: dict[str, Any]) -> GlInfo:
    software = any(name in said.get("renderer", "").lower() for name in _SOFTWARE)
    return GlInfo(available="reason" not in said, software=software, **said)


class GlThread:
    """A context and the only thread that uses it: callers may be in any thread.

    What renderers no longer need is put on `discarded` (never released from a finaliser, which may run in any thread)
    and released before the next piece of work.
    """

    def __init__(self, info: GlInfo) -> None:
        self.info = info
        self.discarded: deque[Any] = deque()
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="cadcam-gl")
        self.context: Any = self._pool.submit(
            gl_probe.open_context, info.device, os.environ.get("CADCAM_LIBEGL"), os.environ.get("CADCAM_LIBGL")
        ).result()
        self.programs: dict[str, Any] = {}

    def submit(self, work: Callable[[], Result]) -> Future[Result]:
        """Run `work` in the context's thread."""
        return self._pool.submit(self._tidied, work)

    def _tidied(self, work: Callable[[], Result]) -> Result:
        while self.discarded:
            self.discarded.popleft().release()
        return work()


def open_gl(device: int | str | None = None) -> GlThread:
    """Return the context of this process on a device, made on first use. Raises `MissingExtra`, `MissingOpenGL`."""
    if find_spec("moderngl") is None:
        raise MissingExtra("the renderer 'gl'", "gl", "moderngl")
    info = probe(device)
    if not info.available:
        raise MissingOpenGL(info.reason)
    try:
        return _opened(info, os.getpid())
    except Exception as error:
        raise MissingOpenGL(" ".join(str(error).split())) from error


@cache
def _opened(info: GlInfo, process: int) -> GlThread:
    """Return the context on a device; one per process, since a fork does not inherit the thread that holds it."""
    return GlThread(info)
