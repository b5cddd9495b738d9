"""The output channels of `render`: each as a file in the format of its suffix, and the wireframe."""

from __future__ import annotations

import argparse
import io
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from cadcam.cli.dress import Dress
from cadcam.cli.looks import look_of
from cadcam.cli.photograph_options import is_photograph
from cadcam.cli.photographs import Photographs
from cadcam.cli.wires import INK, lines_as_json, style_of
from cadcam.errors import BadValue, UnknownName
from cadcam.image.exr import write_exr
from cadcam.image.picture import write_picture
from cadcam.image.png import DEEPEST, depth_step
from cadcam.render import open_renderer
from cadcam.render.lines.visible import LineDrawer
from cadcam.render.lines.wireframe import LineOptions, Wireframe
from cadcam.render.overlay import overlay, write_overlay_svg
from cadcam.render.view import PLAIN, Channel, Look, Scene, View
from cadcam.whole import write_whole

if TYPE_CHECKING:
    from cadcam.camera.camera import Camera
    from cadcam.geometry.rigid import Rigid

Said: TypeAlias = dict[str, Any]  # what the caller should know of a file, as JSON

_WHITE = (1.0, 1.0, 1.0)


class Output(Protocol):
    """A channel of one scene: its frames, and their files. `write` may run in several threads."""

    def frames(self, camera: Camera, poses: Iterable[Rigid]) -> Iterator[Any]:
        """Yield one frame per pose, in order."""
        ...

    def empty(self, frame: Any) -> bool:
        """Whether the frame shows nothing of the model."""
        ...

    def write(self, path: str, frame: Any) -> Said:
        """Write the file, whole; return what the caller should know of it."""
        ...


class RenderedFrames:
    """Channels that a renderer makes; `save` writes one of them."""

    def __init__(
        self,
        scene: Scene,
        arguments: argparse.Namespace,
        channels: Channel,
        save: Callable[[str, View], Said],
        look: Look = PLAIN,
    ) -> None:
        self._renderer = open_renderer(scene, arguments.renderer, threads=arguments.threads)
        self._channels, self._look = channels, look
        self.write: Callable[[str, View], Said] = save

    def frames(self, camera: Camera, poses: Iterable[Rigid]) -> Iterator[View]:
        """Yield the views: a single one on all cores, several of them on one core each."""
        several = tuple(poses)
        if len(several) == 1:
            yield self._renderer.render(camera, several[0], channels=self._channels, look=self._look)
        else:
            yield from self._renderer.render_batch(camera, several, channels=self._channels, look=self._look)

    def empty(self, frame: View) -> bool:
        """Whether no pixel sees the model."""
        return not frame.mask.any()


class DrawnFrames:
    """The wireframe: on paper, or as SVG."""

    def __init__(self, scene: Scene, arguments: argparse.Namespace) -> None:
        self._drawer = LineDrawer(scene)
        self._options = LineOptions(hidden=arguments.hidden)
        self._style, self._title = style_of(arguments, color=INK), arguments.model

    def frames(self, camera: Camera, poses: Iterable[Rigid]) -> Iterator[Wireframe]:
        """Yield the wireframes."""
        for pose in poses:
            yield self._drawer.draw(camera, pose, options=self._options)

    def empty(self, frame: Wireframe) -> bool:
        """Whether no line is in the picture."""
        return frame.empty

    def write(self, path: str, frame: Wireframe) -> Said:
        """Write the lines."""
        if path.lower().endswith(".svg"):
            write_overlay_svg(path, frame, style=self._style, title=self._title)
        else:
            paper = np.ones((frame.camera.height, frame.camera.width), np.float32)
            write_picture(path, overlay(paper, frame, style=self._style))
        return lines_as_json(frame)


def output_of(arguments: argparse.Namespace, scene: Scene, poses: Iterable[Rigid]) -> Output:
    """Return the requested channel."""
    views = partial(RenderedFrames, scene, arguments)
    match arguments.channel:
        case "shaded" if is_photograph(arguments):
            return Photographs(scene, arguments, Dress(arguments, scene))
        case "shaded":
            return views(Channel.IMAGE, Dress(arguments, scene).write, look_of(arguments))
        case "wireframe":
            return DrawnFrames(scene, arguments)
        case "depth":
            return views(Channel.DEPTH, partial(write_depth, step=_step_for(scene, poses)))
        case "normals":
            return views(Channel.NORMAL, write_normals)
        case "parts":
            return views(Channel.PART, partial(write_parts, scene=scene))
        case "faces":
            _check_numbers(arguments.output, scene.mesh.n_faces)
            return views(Channel.FACE, write_faces)
    raise UnknownName("channel", arguments.channel, ("shaded", "wireframe", "depth", "normals", "parts", "faces"))


def write_depth(path: str, view: View, *, step: float) -> Said:
    """Write the z-depth: float32 mm (.npy, .exr), or 16-bit steps of `step` mm (.png)."""
    seen = view.depth[view.mask]
    said: Said = {"seen_pixels": int(view.mask.sum())}
    if len(seen):
        said["depth_mm"] = [float(seen.min()), float(seen.max())]
    if path.lower().endswith(".npy"):
        _write_npy(path, view.depth)
    elif path.lower().endswith(".exr"):
        write_exr(path, {"Z": view.depth})
    else:
        steps = np.where(view.mask, np.clip(view.depth / step, 1, DEEPEST), 0)
        write_picture(path, (steps / DEEPEST).astype(np.float32), bits=16)
        said["depth_mm_per_step"] = step
    return said


def write_normals(path: str, view: View) -> Said:
    """Write the unit normals in the camera frame: float32 (.npy, .exr), or colours (n + 1)/2 (.png)."""
    if path.lower().endswith(".npy"):
        _write_npy(path, view.normal)
    elif path.lower().endswith(".exr"):
        write_exr(path, {axis: view.normal[..., k] for k, axis in enumerate("XYZ")})
    else:
        write_picture(path, np.where(view.mask[..., None], (view.normal + 1) / 2, np.float32(1)))
    return {"seen_pixels": int(view.mask.sum())}


def write_parts(path: str, view: View, *, scene: Scene) -> Said:
    """Write the part numbers: int32, -1 for the background (.npy), or each part in its colour (.png)."""
    names = scene.mesh.part_names
    if path.lower().endswith(".npy"):
        _write_npy(path, view.part)
    else:
        colors = np.concatenate([scene.colors[: len(names)], np.array([_WHITE], np.float32)])
        write_picture(path, colors[view.part])
    numbers, counts = np.unique(view.part[view.mask], return_counts=True)
    seen = {names[i]: {"number": int(i), "pixels": int(n)} for i, n in zip(numbers, counts, strict=True)}
    return {"seen_pixels": int(view.mask.sum()), "seen_parts": seen}


def write_faces(path: str, view: View) -> Said:
    """Write the face numbers: int32, -1 for the background (.npy), or 16 bits of number + 1 (.png)."""
    if path.lower().endswith(".npy"):
        _write_npy(path, view.face)
    else:
        write_picture(path, ((view.face + 1) / DEEPEST).astype(np.float32), bits=16)
    return {"seen_pixels": int(view.mask.sum())}


def _check_numbers(path: str, faces: int) -> None:
    if faces > DEEPEST and not path.lower().endswith(".npy"):
        raise BadValue("the number of faces", faces, f"at most {DEEPEST}, which 16 bits hold, or an output .npy")


def _step_for(scene: Scene, poses: Iterable[Rigid]) -> float:
    """Return the smallest depth step in mm that fits 16 bits for all poses: one for a whole set."""
    box = scene.mesh.box_corners
    return depth_step(max(float((pose @ box)[:, 2].max()) for pose in poses))


def _write_npy(path: str, array: npt.NDArray[Any]) -> None:
    file = io.BytesIO()
    np.save(file, array)
    write_whole(path, file.getvalue())
