"""The interface of all renderers: `Scene`, `Look`, `View` and the `Renderer` protocol. Types only."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Flag, auto
from hashlib import sha256
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Ids, Locked, Mask, Picture, frozen
from cadcam.cad.edges import FeatureEdges, feature_edges
from cadcam.cad.mesh import Mesh, merge
from cadcam.camera.camera import Camera
from cadcam.errors import BadValue, NothingInView
from cadcam.geometry.rigid import Rigid, expect_motion
from cadcam.image.picture import to_gray
from cadcam.kinds import FrozenMap, expect, expect_each, expect_number, expect_numbers, expect_several

# Muted, and distinct for people with any colour vision: hues of Okabe and Ito (2008), lightened for shading.
PALETTE = np.array(
    [
        [0.66, 0.73, 0.80],
        [0.90, 0.72, 0.42],
        [0.55, 0.78, 0.90],
        [0.45, 0.74, 0.64],
        [0.93, 0.90, 0.55],
        [0.45, 0.60, 0.80],
        [0.87, 0.58, 0.42],
        [0.85, 0.68, 0.78],
    ],
    dtype=np.float32,
)


class Channel(Flag):
    """The channels of a view; combine with `|`. RGB is the image once more, in bytes, and not part of ALL."""

    IMAGE = auto()
    DEPTH = auto()
    NORMAL = auto()
    PART = auto()
    FACE = auto()
    RGB = auto()
    ALL = IMAGE | DEPTH | NORMAL | PART | FACE


class Layer(NamedTuple):
    """The format of a view's array: numbers per pixel, their type, and their value where there is no model."""

    numbers: int
    dtype: type[np.generic]
    background: float = 0.0  # for the image and its bytes: from the look

    def shape(self, camera: Camera) -> tuple[int, ...]:
        """Return (H, W), or (H, W, numbers) for more than one."""
        return (camera.height, camera.width, self.numbers)[: 2 + (self.numbers > 1)]

    @property
    def pixel_bytes(self) -> int:
        """Return the bytes of a pixel."""
        return self.numbers * np.dtype(self.dtype).itemsize


_LAYERS: Mapping[Channel, Mapping[str, Layer]] = {
    Channel.IMAGE: {"image": Layer(3, np.float32), "coverage": Layer(1, np.float32)},
    Channel.DEPTH: {"depth": Layer(1, np.float32, np.inf)},
    Channel.NORMAL: {"normal": Layer(3, np.float32)},
    Channel.PART: {"part": Layer(1, np.int32, -1)},
    Channel.FACE: {"face": Layer(1, np.int32, -1)},
    Channel.RGB: {"rgb": Layer(3, np.uint8)},
}


def layers_of(channels: Channel) -> dict[str, Layer]:
    """Return the layers that make up some channels, by name."""
    return {name: layer for channel, layers in _LAYERS.items() if channel in channels for name, layer in layers.items()}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Scene(Locked):
    """A mesh in the world frame (mm), its feature edges and its paint.

    `colors` (C, 3) RGB in [0, 1]: one for each part, then any more; `paint` (F,): the index of each face's colour, by
    default that of its part.
    """

    mesh: Mesh
    edges: FeatureEdges
    colors: Picture
    paint: Ids = field(default_factory=lambda: np.zeros(0, np.int32))

    def __post_init__(self) -> None:
        expect(self.mesh, "mesh", Mesh)
        expect(self.edges, "edges", FeatureEdges)
        colors, parts = frozen(self.colors, "part colours", (None, 3), np.float32), len(self.mesh.part_names)
        given = frozen(self.paint, "paint", (None,), np.int32)
        paint = frozen(given if len(given) else self.mesh.part, "paint", (self.mesh.n_faces,), np.int32)
        if len(colors) < parts or (not len(given) and len(colors) > parts):
            raise BadValue("part colours", f"{len(colors)} long", f"one for each of {parts} parts")
        if len(paint) and not 0 <= int(paint.min()) <= int(paint.max()) < len(colors):
            raise BadValue("paint", f"from {paint.min()} to {paint.max()}", f"numbers from 0 to {len(colors) - 1}")
        object.__setattr__(self, "colors", colors)
        object.__setattr__(self, "paint", paint)

    @classmethod
    def of(cls, mesh: Mesh, *, edges: FeatureEdges | None = None, colors: npt.ArrayLike | None = None) -> Scene:
        """Return the scene of a mesh; edges default to `feature_edges(mesh)`, colours to the file's or a palette."""
        expect(mesh, "mesh", Mesh)
        edges = feature_edges(mesh) if edges is None else edges
        if colors is not None:
            return cls(mesh, edges, np.asarray(colors, np.float32))
        palette = PALETTE[np.arange(len(mesh.part_names)) % len(PALETTE)]
        of_parts = np.where(np.isnan(mesh.part_colors), palette, mesh.part_colors)
        if mesh.face_colors is None:
            return cls(mesh, edges, of_parts)
        own = np.isfinite(mesh.face_colors).all(axis=1)
        paint = mesh.part.copy()
        paint[own] = len(of_parts) + np.arange(own.sum())
        return cls(mesh, edges, np.concatenate([of_parts, mesh.face_colors[own]]), paint)

    @property
    def sha256(self) -> str:
        """The hash of all that is seen: its shape, its edges, and the colour of each face."""
        mesh, edges = self.mesh, self.edges
        normals = np.zeros(0, np.float32) if mesh.corner_normals is None else mesh.corner_normals
        shape = (mesh.vertices, mesh.faces, mesh.part, normals)
        lines = (edges.vertices, edges.faces, edges.kind, edges.chain, edges.part)
        arrays = (*shape, *lines, self.colors[self.paint])
        return sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()

    def repeated(self, poses: Sequence[Rigid]) -> Scene:
        """Return the scene with all that is in this one at each of n poses (world_from_scene): instances of a part.

        Parts and edges come in that order; from the second pose on the parts' names get a number. Where instances
        touch, no edges of contact are added. Raises `BadValue` where there is no pose.
        """
        poses = expect_each(poses, "poses", Rigid)
        n, parts = len(poses), len(self.mesh.part_names)
        mesh = merge([self.mesh.transformed(pose) for pose in poses])
        colors = np.concatenate([np.tile(self.colors[:parts], (n, 1)), self.colors[parts:]])
        of_part = [np.where(self.paint < parts, self.paint + k * parts, self.paint + (n - 1) * parts) for k in range(n)]
        return Scene(mesh, self.edges.repeated(self.mesh, n), colors, np.concatenate(of_part).astype(np.int32))

    def __repr__(self) -> str:
        return f"Scene({self.mesh!r}, {len(self.edges.vertices)} edges)"


@dataclass(frozen=True, slots=True)
class Look:
    """The look of the shaded image; ids, depth and normals do not depend on it.

    Surfaces are matt and two-sided, without cast shadows. Three lights with their strengths: `head` at the camera,
    `fill` and `back` distant ones from `fill_from` and `back_from` (camera frame: x right, y down, z forward; by
    default from above on the left, and from behind on the right, where it highlights surfaces that turn away).
    `ambient` is the rest. `background` RGB in [0, 1]. `supersampling` n takes n x n rays per pixel for the image and
    its coverage; all other channels stay at the centres. Named looks: `cadcam.render.looks`.
    """

    head: float = 0.55
    fill: float = 0.30
    back: float = 0.20
    ambient: float = 0.20
    fill_from: tuple[float, float, float] = (-0.5, -0.8, -0.3)
    back_from: tuple[float, float, float] = (0.9, 0.2, 0.4)
    background: tuple[float, float, float] = (1.0, 1.0, 1.0)
    supersampling: int = 1

    def __post_init__(self) -> None:
        expect_number(self.supersampling, "supersampling")
        if self.supersampling not in range(1, 17):
            raise BadValue("supersampling", self.supersampling, "a whole number from 1 to 16")
        expect_numbers(self)
        strengths = (self.head, self.fill, self.back, self.ambient)
        if not all(0 <= s < float("inf") for s in strengths):
            raise BadValue("(head, fill, back, ambient)", strengths, "numbers of at least 0")
        for what, direction in (("fill_from", self.fill_from), ("back_from", self.back_from)):
            if not 0 < sum(x * x for x in direction) < float("inf"):
                raise BadValue(what, direction, "a direction (x, y, z), not zero")


PLAIN = Look()


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class View:
    """A rendered picture of a scene: arrays of shape (H, W, ...) that `camera` saw from `camera_from_world`.

    Accessing a channel that was not rendered raises `BadValue` naming it.
    """

    camera: Camera
    camera_from_world: Rigid
    layers: Mapping[str, npt.NDArray[Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for layer in self.layers.values():
            layer.setflags(write=False)  # made for this view by a renderer: no copy of what may be large
        object.__setattr__(self, "layers", FrozenMap(self.layers))

    @property
    def image(self) -> Picture:
        """Shaded RGB (H, W, 3) float32 in [0, 1]."""
        return self._layer("image")

    @property
    def coverage(self) -> Picture:
        """Share (H, W) float32 of each pixel's samples that met the model; comes with the image."""
        return self._layer("coverage")

    @property
    def rgb(self) -> npt.NDArray[np.uint8]:
        """Shaded RGB (H, W, 3) uint8, the image rounded to steps of 1/255: for files, screens and OpenCV."""
        return self._layer("rgb")

    @property
    def gray(self) -> Picture:
        """Luma (H, W) float32 of the image."""
        return to_gray(self.image)

    @property
    def depth(self) -> Picture:
        """z-depth (H, W) float32 in mm at pixel centres; inf on the background."""
        return self._layer("depth")

    @property
    def normal(self) -> Picture:
        """Unit normals (H, W, 3) float32 of the faces seen, camera frame, facing the camera; 0 on the background."""
        return self._layer("normal")

    @property
    def part(self) -> Ids:
        """Part numbers (H, W) int32; -1 on the background."""
        return self._layer("part")

    @property
    def face(self) -> Ids:
        """Face numbers (H, W) int32; -1 on the background."""
        return self._layer("face")

    @property
    def mask(self) -> Mask:
        """Pixels (H, W) whose centre sees the model."""
        for name, seen in (("face", lambda a: a >= 0), ("part", lambda a: a >= 0), ("depth", np.isfinite)):
            if name in self.layers:
                return np.asarray(seen(self.layers[name]))
        return np.asarray(self.normal.any(axis=-1)) if "normal" in self.layers else np.asarray(self.coverage > 0)

    def _layer(self, name: str) -> npt.NDArray[Any]:
        if name not in self.layers:
            channel = "IMAGE" if name == "coverage" else name.upper()
            raise BadValue(f"channel {name}", "not rendered", f"Channel.{channel} among the channels asked for")
        return self.layers[name]

    def __repr__(self) -> str:
        return f"View({self.camera.width} x {self.camera.height} px: {', '.join(self.layers)})"


def expect_view(camera: object, poses: Iterable[object], channels: object, look: object) -> None:
    """Raise `BadValue` naming what a renderer cannot draw: no camera, no single pose, no channels, no look."""
    expect(camera, "camera", Camera)
    for pose in poses:
        expect_motion(pose, "camera_from_world")
    expect(channels, "channels", Channel)
    expect(look, "look", Look)


def expect_poses(poses: object) -> None:
    """Raise `BadValue` for what is no list of poses; a `Rigid` of many is one."""
    if not isinstance(poses, Rigid):
        expect_several(poses, "poses", Rigid)


class Renderer(Protocol):
    """Created once from a scene (acceleration structures, uploads), then used for many views; one thread at a time.

    The world frame is the mesh's. Renderers agree on which face a pixel centre sees, except within their own documented
    sub-pixel resolution of an edge.
    """

    name: str

    @property
    def scene(self) -> Scene:
        """The scene it was made from."""
        ...

    def render(
        self,
        camera: Camera,
        camera_from_world: Rigid,
        *,
        channels: Channel = Channel.ALL,
        look: Look = PLAIN,
    ) -> View:
        """Return the view; where the model is not in it, an empty one (see `nothing_in_view`)."""
        ...

    def render_batch(
        self,
        camera: Camera,
        poses: Iterable[Rigid],
        *,
        channels: Channel = Channel.ALL,
        look: Look = PLAIN,
    ) -> Iterator[View]:
        """Yield a view for each camera_from_world, in order, empty ones included."""
        ...


def with_image(channels: Channel) -> Channel:
    """Return the channels to draw for those requested: RGB is made from IMAGE."""
    return (channels & ~Channel.RGB) | Channel.IMAGE if Channel.RGB in channels else channels


def with_rgb(layers: Mapping[str, npt.NDArray[Any]], channels: Channel) -> dict[str, npt.NDArray[Any]]:
    """Return the layers of `with_image(channels)` as those of `channels`."""
    if Channel.RGB not in channels:
        return dict(layers)
    kept = {name: a for name, a in layers.items() if Channel.IMAGE in channels or name not in ("image", "coverage")}
    return kept | {"rgb": (layers["image"] * np.float32(255) + np.float32(0.5)).astype(np.uint8)}


def nothing_in_view(mesh: Mesh, camera: Camera, camera_from_world: Rigid) -> NothingInView:
    """Return the error that says where the model's box lies, in the camera frame (mm) and in the picture (px)."""
    p = camera_from_world @ mesh.box_corners
    box = " x ".join(f"[{a:.0f}, {b:.0f}]" for a, b in zip(p.min(axis=0), p.max(axis=0), strict=True))
    text = f"the model's box spans {box} mm in the camera frame (x right, y down, z forward)"
    if p[:, 2].max() <= 0:
        return NothingInView(
            f"the model lies wholly behind the camera: {text}; is the pose camera_from_world inverted?"
        )
    q = camera.project(p)
    q = q[np.isfinite(q).all(axis=1)]
    where = (
        f"projects to x [{q[:, 0].min():.0f}, {q[:, 0].max():.0f}], y [{q[:, 1].min():.0f}, {q[:, 1].max():.0f}] px"
        if len(q)
        else "lies outside the lens' valid radius"
    )
    return NothingInView(
        f"nothing of the model is in the {camera.width} x {camera.height} px picture: {text} and {where}; "
        "check the pose and the model's unit"
    )
