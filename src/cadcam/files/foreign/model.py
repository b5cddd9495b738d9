"""The definition of a foreign format: what it holds, how it is recognised, its reader and its writer."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol, TypeAlias

from cadcam.camera.camera import Camera
from cadcam.camera.estimate import CameraEstimate
from cadcam.errors import UnknownName
from cadcam.files.foreign.source import ForeignFile
from cadcam.geometry.rigid import Rigid

Files: TypeAlias = Mapping[str, bytes]  # a writer's result: content by name; "" is the requested path


@dataclass(frozen=True, slots=True, eq=False)
class NamedCamera:
    """A camera with its name in a file, its pose if the file gives one, and from our own files its estimate."""

    name: str
    camera: Camera
    camera_from_world: Rigid | None = None
    estimate: CameraEstimate | None = None

    def __post_init__(self) -> None:
        printable = "".join(c if c.isprintable() else "_" for c in self.name.encode("utf-8", "replace").decode())
        object.__setattr__(self, "name", printable.strip() or "camera")


@dataclass(frozen=True, slots=True, eq=False)
class Foreign:
    """The contents of a file: its cameras in our conventions, and sentences for the user.

    format: the name in the table of formats.
    """

    format: str
    cameras: tuple[NamedCamera, ...]
    notes: tuple[str, ...] = ()

    def named(self, name: str | None) -> Foreign:
        """Return the same with one camera only, chosen by its name or its index from 0; all of them for None."""
        if name is None:
            return self
        by_name = {camera.name: camera for camera in self.cameras}
        by_name |= {str(i): c for i, c in enumerate(self.cameras) if str(i) not in by_name}
        if name not in by_name:
            raise UnknownName("camera", name, [camera.name for camera in self.cameras])
        return replace(self, cameras=(by_name[name],))


@dataclass(frozen=True, slots=True)
class ConversionLoss:
    """Something that a format cannot hold: `what` names it, `text` describes it, `px` how far it moves pixels."""

    what: str
    text: str
    px: float = 0.0

    @property
    def moves_pixels(self) -> bool:
        """Return whether the written camera differs: then the user's consent is required (`allow_loss`)."""
        return self.what in PIXEL_LOSSES

    def __str__(self) -> str:
        return f"{self.what}: {self.text}" + (f" (moves pixels by up to {self.px:.3g} px)" if self.px else "")


PIXEL_LOSSES = ("lens", "skew", "aspect", "principal-point")


@dataclass(frozen=True, slots=True)
class Holds:
    """What a format can hold.

    lenses: for each lens model the coefficients it can have; others must be zero. skew: "ignored" where the file keeps
    it but the format's own programs do not use it. aspect: fx other than fy. pose: "relative" where only the cameras'
    relative poses are kept. several: more than one camera. estimate: covariance and observations.
    """

    lenses: Mapping[str, tuple[str, ...]]
    skew: Literal["yes", "no", "ignored"] = "no"
    aspect: bool = True
    principal_point: bool = True
    size: bool = True
    pose: Literal["yes", "no", "relative"] = "no"
    several: bool = False
    estimate: bool = False


@dataclass(frozen=True, slots=True)
class WriteOptions:
    """Options of a writer: the requested name, millimetres per unit of length, pixel pitch in mm (None: not known)."""

    name: str
    mm: float = 1.0
    pixel_mm: float | None = None


class Holder(Protocol):
    """The interface of a target for `losses.prepared`: its name for people, what it holds, and losses of its own."""

    @property
    def title(self) -> str:
        """Return its name for people."""
        ...

    @property
    def holds(self) -> Holds:
        """Return what it can hold."""
        ...

    def extra_losses(self, named: NamedCamera, /) -> Sequence[ConversionLoss]:
        """Return further losses of a camera that fits."""
        ...


@dataclass(frozen=True, slots=True)
class Format:
    """One foreign format. unit is that of its lengths, None without one of its own; folder: written as a folder."""

    name: str
    title: str
    suffixes: tuple[str, ...]
    holds: Holds
    recognises: Callable[[ForeignFile], bool]
    read: Callable[[ForeignFile], Foreign]
    write: Callable[[Sequence[NamedCamera], WriteOptions], Files]
    unit: str | None = None
    folder: bool = False
    extra_losses: Callable[[NamedCamera], Sequence[ConversionLoss]] = lambda _: ()
