"""The available OpenGL devices on EGL; run as a script in its own process, because a broken driver may crash it.

Prints one JSON object per device and imports nothing of cadcam: it must also run as a single file.
"""

from __future__ import annotations

import json
import sys
from typing import Any

VERSION = 430  # storage buffers, compute shaders and double precision
LIBEGL = ("libEGL.so.1",)
LIBGL = ("libGL.so.1", "libOpenGL.so.0")
MOST_DEVICES = 16


def open_context(device: int, libegl: str | None, libgl: str | None) -> Any:
    """Return a moderngl context without a window on the EGL device of this index; raises whatever goes wrong."""
    import moderngl

    names = [(egl, gl) for egl in ([libegl] if libegl else LIBEGL) for gl in ([libgl] if libgl else LIBGL)]
    for k, (egl, gl) in enumerate(names):
        try:
            named: dict[str, Any] = {"backend": "egl", "device_index": device, "libegl": egl, "libgl": gl}
            return moderngl.create_context(standalone=True, require=VERSION, **named)
        except Exception as error:
            if k == len(names) - 1 or "not loaded" not in str(error):
                raise
    raise AssertionError("unreachable")


def main(libegl: str, libgl: str) -> None:
    """Print the description of each device, then why the next one could not be opened."""
    for device in range(MOST_DEVICES):
        try:
            context = open_context(device, libegl or None, libgl or None)
            said = {key: str(context.info[f"GL_{key.upper()}"]) for key in ("renderer", "vendor", "version")}
            context.release()
        except Exception as error:
            print(json.dumps({"device": device, "reason": " ".join(str(error).split()) or type(error).__name__}))
            if "found" in str(error) or "not loaded" in str(error):
                return
        else:
            print(json.dumps({"device": device, **said}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:3])
