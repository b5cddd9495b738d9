"""cadcam: the virtual camera. From a calibration to a picture of the CAD model, and from a photo back to CAD.

Names are imported on first use, so that `import cadcam` costs next to nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_HOME = {
    "CadcamError": "cadcam.errors",
    "Rigid": "cadcam.geometry.rigid",
    "Camera": "cadcam.camera.camera",
}
__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'cadcam' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
