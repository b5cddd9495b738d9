"""A scene on the GPU and the drawing of its views. Everything here runs in the context's thread."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Picture
from cadcam.camera.camera import Camera
from cadcam.camera.lens import Ideal
from cadcam.camera.opengl import model_view_matrix, projection_matrix
from cadcam.errors import NotEnoughMemory
from cadcam.geometry.rigid import Rigid
from cadcam.render.gl import shaders as glsl
from cadcam.render.gl.context import GlThread
from cadcam.render.gl.pieces import NEAR_SHARE, PIECE_REACH_PX, REACH_PX, Pieces, pieces
from cadcam.render.gl.target import Tables, Target
from cadcam.render.gl.tiles import Tile, tiles
from cadcam.render.shade import unit
from cadcam.render.view import Channel, Look, Scene, layers_of

Layers = dict[str, npt.NDArray[Any]]

_WORDS = {name: layer.pixel_bytes // 4 for name, layer in layers_of(Channel.ALL).items()}  # of a pixel
TILE_SIDE, TILE_PIXELS = 8192, 3_200_000  # at 10 words a pixel within the 128 MiB that OpenGL guarantees for a buffer
_ITEMS, _ROW = 64, 1 << 15  # shader invocations in a group, groups along x before the next row of them


class GpuScene:
    """Buffers of one scene, and those of its last view."""

    def __init__(self, thread: GlThread, scene: Scene) -> None:
        self._gl, self._scene = thread.context, scene
        self._programs = thread.programs or _compile(thread)
        self._check_size(thread.info.renderer)
        mesh = scene.mesh
        self._faces = np.ascontiguousarray(mesh.faces, np.int32)
        self._owned = ExitStack()
        self._vertices = self._buffer(self._owned, np.ascontiguousarray(mesh.vertices, np.float64))
        self._corners = self._buffer(self._owned, self._faces)
        self._kinds = self._buffer(self._owned, np.column_stack([mesh.part, scene.paint]).astype(np.int32))
        self._colors = self._buffer(self._owned, np.ascontiguousarray(scene.colors, np.float32))
        self._pose = self._buffer(self._owned, np.zeros(34))
        self._positions = self._buffer(self._owned, np.zeros((len(mesh.vertices), 4), np.float32))
        self._planes = self._buffer(self._owned, np.zeros((mesh.n_faces, 5), np.float32))
        self._edges = self._buffer(self._owned, np.zeros(9, np.float32))
        self._all = self._vertex_array(self._owned, "see", self._positions, self._corners)
        self._target = Target(self._gl)
        self._tables = Tables(self._gl)
        self._owned.callback(self._target.release)
        self._owned.callback(self._tables.release)

    def release(self) -> None:
        """Release everything; may be called again."""
        self._owned.close()

    def fill(self, layers: Layers, camera: Camera, pose: Rigid, look: Look) -> bool:
        """Draw a view into layers, those of the image with the number of samples of the look.

        Returns False, and leaves them as they are, if all of the scene is behind the camera.
        """
        low, high = _depth_range(self._scene, pose)
        if high <= 0:
            return False
        fine = {k: v for k, v in layers.items() if look.supersampling > 1 and k in ("image", "coverage")}
        plain = {k: v for k, v in layers.items() if k not in fine}
        mesh = self._scene.mesh
        distorted = not isinstance(camera.lens, Ideal)
        bent = pieces(camera, pose, mesh.vertices, self._faces) if distorted else None
        for chosen, n in ((plain, 1), (fine, look.supersampling)):
            if not chosen:
                continue
            for tile in tiles(camera.size, side=self._side() // n, pixels=TILE_PIXELS // n**2):
                self._pose.write(_pose_block(tile.camera(camera, n), pose, high))
                self._see(camera, tile, n, (max(low, 0.0), high), bent)
                self._resolve(tile, n, chosen, look)
        return True

    def _see(self, camera: Camera, tile: Tile, n: int, depths: tuple[float, float], bent: Pieces | None) -> None:
        """Find the face that each sample of a tile sees."""
        see, fine = self._programs["see" if bent is None else "see_bent"], tile.camera(camera, n)
        self._run("planes", self._scene.mesh.n_faces, self._planes)
        see["height"] = fine.height
        see["depth_range"] = depths[0], 1 / max(depths[1] - depths[0], 1e-30)
        self._target.begin(fine.size)
        if bent is None:
            self._run("transform", len(self._scene.mesh.vertices), self._positions)
            inverse = np.linalg.inv(fine.K)
            see["plane_x"], see["plane_y"] = tuple(inverse[0]), tuple(inverse[1])
            self._planes.bind_to_storage_buffer(3)
            self._all.render()
        else:
            self._tables.get(camera, tile, n).use(0)
            see["half_size"] = fine.width / 2, fine.height / 2
            self._draw_bent(bent, tile, n)
        self._programs["resolve"]["distorted"] = bent is not None

    def _draw_bent(self, bent: Pieces, tile: Tile, n: int) -> None:
        """Draw the faces that the lens leaves nearly straight, then the pieces of all others."""
        self._positions.write(_clip_positions(bent.q, tile))
        self._edges.orphan(36 * len(self._faces))
        self._run("edges", len(self._faces), self._edges)
        self._planes.bind_to_storage_buffer(3)
        self._edges.bind_to_storage_buffer(4)
        kept = np.where(bent.whole[:, None], self._faces, np.int32(0))
        with ExitStack() as passing:
            index = self._buffer(passing, kept)
            index.bind_to_storage_buffer(5)
            self._programs["see_bent"]["pieces"], self._programs["see_bent"]["width"] = False, REACH_PX * n
            self._vertex_array(passing, "see_bent", self._positions, index).render()
            if len(bent.face):
                corners = self._buffer(passing, _clip_positions(bent.corners.reshape(-1, 2), tile))
                self._buffer(passing, bent.face).bind_to_storage_buffer(5)
                self._programs["see_bent"]["pieces"], self._programs["see_bent"]["width"] = True, PIECE_REACH_PX * n
                self._vertex_array(passing, "see_bent", corners, None).render()

    def _resolve(self, tile: Tile, n: int, layers: Layers, look: Look) -> None:
        """Compute a tile's layers from the faces seen, and fetch them."""
        resolve, pixels = self._programs["resolve"], tile.width * tile.height
        resolve["light"] = (look.ambient, look.head, look.fill, look.back)
        resolve["fill_from"], resolve["back_from"] = tuple(unit(look.fill_from)), tuple(unit(look.back_from))
        resolve["background"] = tuple(look.background)
        resolve["size"], resolve["samples"] = (tile.width, tile.height), n
        start = {name: sum(_WORDS[k] for k in list(layers)[:i]) * pixels for i, name in enumerate(layers)}
        for name in _WORDS:
            resolve[f"at_{name}"] = start.get(name, -1)
        out = self._target.output(4 * pixels * sum(_WORDS[name] for name in layers))
        self._target.use()
        self._run("resolve", pixels, self._kinds, self._colors, out)
        for name, layer in layers.items():
            _fetch(out, 4 * start[name], layer, tile)

    def _run(self, name: str, items: int, *buffers: Any) -> None:
        """Run a compute shader over a number of items and make its results visible to all that follows."""
        for k, buffer in enumerate((self._vertices, self._corners, self._pose, *buffers)):
            buffer.bind_to_storage_buffer(k)
        program, groups = self._programs[name], -(-items // _ITEMS)
        if name != "resolve":
            program["count"] = items
        program.run(min(groups, _ROW), -(-groups // _ROW))
        self._gl.memory_barrier()

    def _buffer(self, owner: ExitStack, data: npt.NDArray[Any]) -> Any:
        buffer = self._gl.buffer(data)
        owner.callback(buffer.release)
        return buffer

    def _vertex_array(self, owner: ExitStack, program: str, positions: Any, index: Any) -> Any:
        array = self._gl.vertex_array(self._programs[program], [(positions, "4f", "position")], index_buffer=index)
        owner.callback(array.release)
        return array

    def _side(self) -> int:
        info = self._gl.info
        return int(min(TILE_SIDE, *info["GL_MAX_VIEWPORT_DIMS"], info["GL_MAX_TEXTURE_SIZE"]))

    def _check_size(self, device: str) -> None:
        limit, mesh = int(self._gl.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"]), self._scene.mesh
        need = max(24 * len(mesh.vertices), 36 * mesh.n_faces)
        if need > limit:
            raise NotEnoughMemory(
                f"a mesh of {mesh.n_faces} faces needs a buffer of {need >> 20} MiB; the largest of {device} "
                f"is {limit >> 20} MiB; use the renderer 'auto'"
            )


def _compile(thread: GlThread) -> dict[str, Any]:
    """Compile the programs once per context."""
    gl = thread.context
    programs = {
        "transform": gl.compute_shader(glsl.TRANSFORM),
        "planes": gl.compute_shader(glsl.PLANES),
        "edges": gl.compute_shader(glsl.EDGES),
        "see": gl.program(vertex_shader=glsl.VERTEX, fragment_shader=glsl.FRAGMENT),
        "see_bent": gl.program(
            vertex_shader=glsl.VERTEX, geometry_shader=glsl.WIDEN, fragment_shader=glsl.BENT_FRAGMENT
        ),
        "resolve": gl.compute_shader(glsl.RESOLVE),
    }
    programs["see_bent"]["table"] = programs["resolve"]["table"] = 0
    programs["resolve"]["ids"], programs["resolve"]["depths"] = 1, 2
    thread.programs.update(programs)
    return thread.programs


def _depth_range(scene: Scene, pose: Rigid) -> tuple[float, float]:
    """Return bounds of the z-depth of the scene, mm."""
    low, high = scene.mesh.bounds
    centre = float((pose @ ((low + high) / 2))[2])
    reach = float(np.abs(pose.rotation[2]) @ ((high - low) / 2)) * (1 + 1e-6) + 1e-9 * abs(centre)
    return centre - reach, centre + reach


def _pose_block(camera: Camera, pose: Rigid, farthest: float) -> Array:
    """Return the contents of the shaders' `Pose` block, in its order."""
    clip = projection_matrix(camera, near=NEAR_SHARE * farthest, far=2 * farthest) @ model_view_matrix(pose)
    return np.concatenate([pose.rotation.ravel(), pose.translation, clip.ravel(), np.linalg.inv(camera.K)[:2].ravel()])


def _clip_positions(q: Array, tile: Tile) -> Picture:
    """Return OpenGL's positions (N, 4) of pixels q (N, 2) of the picture in one of its tiles; depth is added later."""
    out = np.zeros((len(q), 4), np.float32)
    out[:, 0] = 2 * (q[:, 0] - tile.x + 0.5) / tile.width - 1
    out[:, 1] = 1 - 2 * (q[:, 1] - tile.y + 0.5) / tile.height
    out[:, 3] = 1
    out[~np.isfinite(out).all(axis=1)] = 0  # no face that is drawn uses these
    return out


def _fetch(buffer: Any, offset: int, layer: npt.NDArray[Any], tile: Tile) -> None:
    """Copy one layer of a tile from the GPU."""
    part = layer[tile.rows, tile.columns]
    into = part if part.flags.c_contiguous else np.zeros_like(part, order="C")
    buffer.read_into(into, into.nbytes, offset=offset)
    if into is not part:
        part[:] = into
