"""A scene on the GPU and the drawing of its views. Everything here runs in the context's thread."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids
from cadcam.camera.camera import Camera
from cadcam.camera.lens import Ideal
from cadcam.camera.opengl import model_view_matrix, projection_matrix
from cadcam.errors import NotEnoughMemory
from cadcam.geometry.rigid import Rigid
from cadcam.render.gl import shaders as glsl
from cadcam.render.gl.bend import bend_table
from cadcam.render.gl.context import GlThread
from cadcam.render.gl.pieces import NEAR_SHARE, REACH_PX, frustum_of, pieces
from cadcam.render.gl.target import Tables, Target
from cadcam.render.gl.tiles import Tile, tiles
from cadcam.render.shade import unit
from cadcam.render.view import Channel, Look, Scene, layers_of

Layers = dict[str, npt.NDArray[Any]]
Cut = tuple[Any, Any] | None  # pieces of faces: their vertex array, and the buffer of the face of each

_SEE = ("see", "see_bent")  # programs for cameras without distortion, and for all others
_WORDS = {name: layer.pixel_bytes // 4 for name, layer in layers_of(Channel.ALL).items()}  # of a pixel
TILE_SIDE, TILE_PIXELS = 8192, 3_200_000  # at 10 words a pixel within the 128 MiB that OpenGL guarantees for a buffer
_MARGIN_PX = 1.0  # by which faces drawn as they are are widened, beyond their bulge; their vertices are 0.1 px off
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
        self._large = self._buffer(self._owned, np.zeros(1, np.int32))
        self._plain, self._bent = (
            self._vertex_array(self._owned, name, self._positions, self._corners) for name in _SEE
        )
        self._box = mesh.bounds
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
        low, high = _depth_range(self._box, pose)
        if high <= 0:
            return False
        fine = {k: v for k, v in layers.items() if look.supersampling > 1 and k in ("image", "coverage")}
        plain = {k: v for k, v in layers.items() if k not in fine}
        self._pose.write(_pose_block(camera, pose, high))
        self._run("planes", len(self._faces), self._planes)
        with ExitStack() as passing:
            cut = None if isinstance(camera.lens, Ideal) else self._bend(passing, camera, pose, high)
            for chosen, n in ((plain, 1), (fine, look.supersampling)):
                if not chosen:
                    continue
                for tile in tiles(camera.size, side=self._side() // n, pixels=TILE_PIXELS // n**2):
                    self._pose.write(_pose_block(tile.camera(camera, n), pose, high))
                    self._see(camera, tile, n, (max(low, 0.0), high), cut)
                    self._resolve(tile, n, chosen, look)
        return True

    def _bend(self, passing: ExitStack, camera: Camera, pose: Rigid, farthest: float) -> Cut:
        """Find the vertices in the picture, which rays meet each face, and the pieces of faces that have to be cut."""
        frustum, bend = frustum_of(camera, NEAR_SHARE * farthest), self._programs["bend"]
        table = bend_table(camera, frustum)
        self._tables.nodes(table).use(0)
        bend["first"], bend["per"] = tuple(table.low), tuple(1 / table.step)
        bend["low"], bend["high"], bend["nearest"] = tuple(frustum.low), tuple(frustum.high), frustum.near
        self._run("bend", len(self._scene.mesh.vertices), self._positions)
        self._edges.orphan(36 * len(self._faces))
        self._run("edges", len(self._faces), self._edges)
        large = self._large_faces()
        corners, owner = pieces(camera, frustum, pose @ self._scene.mesh.vertices[self._faces[large]])
        if not len(owner):
            return None
        array = self._vertex_array(passing, "see_bent", self._buffer(passing, _positions(corners)), None)
        return array, self._buffer(passing, large[owner])

    def _large_faces(self) -> Ids:
        """Return the faces that have to be cut, in ascending order."""
        self._large.orphan(4 * (len(self._faces) + 1))
        self._large.write(bytes(4))
        self._run("large", len(self._faces), self._positions, self._large)
        count = int(np.frombuffer(self._large.read(4), np.int32)[0])
        found = self._large.read(4 * count, offset=4) if count else b""
        return np.sort(np.frombuffer(found, np.int32))

    def _see(self, camera: Camera, tile: Tile, n: int, depths: tuple[float, float], cut: Cut) -> None:
        """Find the face that each sample of a tile sees."""
        plain, fine = isinstance(camera.lens, Ideal), tile.camera(camera, n)
        self._programs["resolve"]["distorted"] = not plain
        see = self._programs[_SEE[0] if plain else _SEE[1]]
        see["height"] = fine.height
        see["depth_range"] = depths[0], 1 / max(depths[1] - depths[0], 1e-30)
        if plain:
            self._run("transform", len(self._scene.mesh.vertices), self._positions)
            inverse = np.linalg.inv(fine.K)
            see["plane_x"], see["plane_y"] = tuple(inverse[0]), tuple(inverse[1])
        else:
            self._tables.get(camera, tile, n).use(0)
            see["half_size"], see["corner"], see["samples"] = (fine.width / 2, fine.height / 2), (tile.x, tile.y), n
            see["pieces"], see["reach"] = False, _MARGIN_PX
            self._edges.bind_to_storage_buffer(4)
        self._planes.bind_to_storage_buffer(3)
        self._target.begin(fine.size)
        (self._plain if plain else self._bent).render()
        if cut is not None:
            see["pieces"], see["reach"] = True, REACH_PX
            cut[1].bind_to_storage_buffer(5)
            cut[0].render()

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
        "bend": gl.compute_shader(glsl.BEND),
        "large": gl.compute_shader(glsl.LARGE),
        "see": gl.program(vertex_shader=glsl.VERTEX, fragment_shader=glsl.FRAGMENT),
        "see_bent": gl.program(
            vertex_shader=glsl.VERTEX, geometry_shader=glsl.WIDEN, fragment_shader=glsl.BENT_FRAGMENT
        ),
        "resolve": gl.compute_shader(glsl.RESOLVE),
    }
    programs["see_bent"]["table"] = programs["resolve"]["table"] = programs["bend"]["nodes"] = 0
    programs["resolve"]["ids"], programs["resolve"]["depths"] = 1, 2
    thread.programs.update(programs)
    return thread.programs


def _depth_range(box: Array, pose: Rigid) -> tuple[float, float]:
    """Return bounds of the z-depth of a box (2, 3), mm."""
    low, high = box
    centre = float((pose @ ((low + high) / 2))[2])
    reach = float(np.abs(pose.rotation[2]) @ ((high - low) / 2)) * (1 + 1e-6) + 1e-9 * abs(centre)
    return centre - reach, centre + reach


def _pose_block(camera: Camera, pose: Rigid, farthest: float) -> Array:
    """Return the contents of the shaders' `Pose` block, in its order."""
    clip = projection_matrix(camera, near=NEAR_SHARE * farthest, far=2 * farthest) @ model_view_matrix(pose)
    return np.concatenate([pose.rotation.ravel(), pose.translation, clip.ravel(), np.linalg.inv(camera.K)[:2].ravel()])


def _positions(q: Array) -> npt.NDArray[np.float32]:
    """Return the positions (N, 4) of pixels q (..., 2) as the shaders know them."""
    out = np.zeros((q.size // 2, 4), np.float32)
    out[:, :2] = q.reshape(-1, 2)
    out[~np.isfinite(out).all(axis=1)] = 0
    return out


def _fetch(buffer: Any, offset: int, layer: npt.NDArray[Any], tile: Tile) -> None:
    """Copy one layer of a tile from the GPU."""
    part = layer[tile.rows, tile.columns]
    into = part if part.flags.c_contiguous else np.zeros_like(part, order="C")
    buffer.read_into(into, into.nbytes, offset=offset)
    if into is not part:
        part[:] = into
