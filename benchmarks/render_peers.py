"""The renderers that benchmarks/render.py compares, each used for speed as its documentation recommends.

All return (8-bit colour (H, W, 3) or None, z-depth (H, W) in mm), shaded flat by face normals. Ray casters get the
exact rays of the camera, cached as long as the camera stays the same; others draw without distortion.
"""

from __future__ import annotations

import importlib
import math
import os
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array
from cadcam.cad.edges import NO_EDGES
from cadcam.cad.mesh import Mesh
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.render import open_renderer
from cadcam.render.raster import RasterRenderer
from cadcam.render.ray import RayRenderer
from cadcam.render.view import Channel, Renderer, Scene

Frame = tuple[npt.NDArray[Any] | None, npt.NDArray[Any]]
NEAR, FAR = 100.0, 20_000.0  # mm; enough for the block


def module(name: str) -> Any:
    """Return a module that need not be installed, and whose types are its own affair."""
    return importlib.import_module(name)


class Peer(Protocol):
    """What a renderer must do here."""

    exact_lens: bool

    def frame(self, camera: Camera, pose: Rigid, *, color: bool) -> Frame:
        """Render one frame."""
        ...


class Raster:
    """Ours."""

    exact_lens = True

    def __init__(self, mesh: Mesh, *, threads: int | None = None) -> None:
        self._renderer: Renderer = RasterRenderer(Scene.of(mesh, edges=NO_EDGES), threads=threads)

    def frame(self, camera: Camera, pose: Rigid, *, color: bool) -> Frame:
        """Render one frame."""
        view = self._renderer.render(camera, pose, channels=Channel.RGB | Channel.DEPTH if color else Channel.DEPTH)
        return (view.rgb if color else None), view.depth


class Ray(Raster):
    """Ours, by ray casting."""

    def __init__(self, mesh: Mesh) -> None:
        self._renderer = RayRenderer(Scene.of(mesh, edges=NO_EDGES))


class Gl(Raster):
    """Ours, by OpenGL."""

    def __init__(self, mesh: Mesh) -> None:
        self._renderer = open_renderer(Scene.of(mesh, edges=NO_EDGES), "gl")


class Rays:
    """The unit rays of the last camera; shading for ray casters."""

    exact_lens = True

    def __init__(self) -> None:
        self._of: Camera | None = None
        self._rays: Array = np.zeros((0, 3))

    def directions(self, camera: Camera) -> Array:
        """Return (H, W, 3) float32 unit rays in the camera frame."""
        if self._of is not camera:
            self._rays = camera.unproject(camera.pixel_grid()).astype(np.float32)
            self._of = camera
        return self._rays

    def shaded(self, normals: npt.NDArray[Any], rays: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return a grey picture as RGB, lit from the camera."""
        light = 0.2 + 0.8 * np.abs(np.einsum("...i,...i->...", normals, rays))
        return np.repeat((255 * np.clip(light, 0, 1)).astype(np.uint8)[..., None], 3, axis=-1)


class TrimeshEmbree(Rays):
    """trimesh's ray interface over embreex."""

    def __init__(self, mesh: Mesh) -> None:
        super().__init__()
        self._mesh = module("trimesh").Trimesh(mesh.vertices, mesh.faces, process=False)
        self._normals = np.asarray(self._mesh.face_normals, np.float32)
        self._cast = module("trimesh.ray.ray_pyembree").RayMeshIntersector(self._mesh)

    def frame(self, camera: Camera, pose: Rigid, *, color: bool) -> Frame:
        """Render one frame."""
        rays = self.directions(camera).reshape(-1, 3)
        world = rays @ pose.rotation.astype(np.float32)
        origins = np.broadcast_to(pose.origin, world.shape)
        face, ray, where = self._cast.intersects_id(origins, world, multiple_hits=False, return_locations=True)
        depth = np.full(len(rays), np.inf, np.float32)
        depth[ray] = (where @ pose.rotation.T + pose.translation)[:, 2]
        image: npt.NDArray[Any] | None = None
        if color:
            image = np.full((len(rays), 3), 255, np.uint8)
            image[ray] = self.shaded(self._normals[face], world[ray])
            image.shape = (camera.height, camera.width, 3)
        return image, depth.reshape(camera.height, camera.width)


class Open3D(Rays):
    """Open3D's RaycastingScene (Embree)."""

    def __init__(self, mesh: Mesh) -> None:
        super().__init__()
        self._o3d = open3d = module("open3d")
        self._scene = open3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            open3d.core.Tensor(mesh.vertices.astype(np.float32)), open3d.core.Tensor(mesh.faces.astype(np.uint32))
        )

    def frame(self, camera: Camera, pose: Rigid, *, color: bool) -> Frame:
        """Render one frame."""
        rays = self.directions(camera)
        world = rays @ pose.rotation.astype(np.float32)
        six = np.concatenate([np.broadcast_to(pose.origin.astype(np.float32), world.shape), world], axis=-1)
        hit = self._scene.cast_rays(self._o3d.core.Tensor(np.ascontiguousarray(six)))
        depth = hit["t_hit"].numpy() * rays[..., 2]
        return (self.shaded(hit["primitive_normals"].numpy(), world) if color else None), depth


class Mitsuba(Rays):
    """Mitsuba 3's ray intersection, compiled by LLVM."""

    def __init__(self, mesh: Mesh) -> None:
        super().__init__()
        self._mi, self._dr = mi, _ = module("mitsuba"), module("drjit")
        mi.set_variant("llvm_ad_rgb")
        shape = mi.Mesh("block", vertex_count=len(mesh.vertices), face_count=mesh.n_faces)
        parameters = mi.traverse(shape)
        parameters["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
        parameters["faces"] = mesh.faces.astype(np.uint32).ravel()
        parameters.update()
        self._scene = mi.load_dict({"type": "scene", "shape": shape})

    def frame(self, camera: Camera, pose: Rigid, *, color: bool) -> Frame:
        """Render one frame."""
        mi = self._mi
        rays = self.directions(camera)
        world = rays @ pose.rotation.astype(np.float32)
        # opaque: as a literal the position would be compiled into a kernel of its own at every frame
        origin = mi.Point3f(*(self._dr.opaque(mi.Float, x) for x in pose.origin.tolist()))
        ray = mi.Ray3f(origin, mi.Vector3f(np.ascontiguousarray(world.reshape(-1, 3).T)))
        if not color:
            return None, np.array(self._scene.ray_intersect_preliminary(ray).t).reshape(rays.shape[:2]) * rays[..., 2]
        hit = self._scene.ray_intersect(ray, mi.RayFlags.Minimal, True)
        depth = np.array(hit.t).reshape(rays.shape[:2]) * rays[..., 2]
        return self.shaded(np.array(hit.n).T.reshape(rays.shape), world), depth


class ModernGL:
    """moderngl on EGL: flat shading from derivatives, z written to a float target of its own."""

    exact_lens = False
    VERTEX = """#version 330
        uniform mat4 P; uniform mat4 V; in vec3 p; out vec3 c;
        void main() { vec4 q = V * vec4(p, 1); c = q.xyz; gl_Position = P * vec4(q.x, -q.y, -q.z, 1); }"""
    COLOR = """#version 330
        in vec3 c; layout(location=0) out float z; layout(location=1) out vec4 rgb;
        void main() {
            vec3 n = normalize(cross(dFdx(c), dFdy(c)));
            z = c.z; rgb = vec4(vec3(0.2 + 0.8 * abs(dot(n, normalize(c)))), 1); }"""
    DEPTH = "#version 330\nin vec3 c; out float z; void main() { z = c.z; }"

    def __init__(self, mesh: Mesh) -> None:
        moderngl = module("moderngl")
        self._gl = moderngl.create_standalone_context(backend="egl")
        self._gl.enable(moderngl.DEPTH_TEST)
        vertices = self._gl.buffer(mesh.vertices.astype("f4").tobytes())
        faces = self._gl.buffer(mesh.faces.astype("i4").tobytes())
        self._draw: dict[bool, tuple[Any, Any]] = {}
        for color, fragment in ((True, self.COLOR), (False, self.DEPTH)):
            program = self._gl.program(vertex_shader=self.VERTEX, fragment_shader=fragment)
            self._draw[color] = program, self._gl.vertex_array(program, [(vertices, "3f", "p")], faces)
        self._targets: dict[tuple[tuple[int, int], bool], Any] = {}

    def _target(self, size: tuple[int, int], color: bool) -> Any:
        if (size, color) not in self._targets:
            layers = [self._gl.texture(size, 1, dtype="f4")] + ([self._gl.texture(size, 4)] if color else [])
            self._targets[size, color] = self._gl.framebuffer(layers, self._gl.depth_renderbuffer(size))
        return self._targets[size, color]

    def frame(self, camera: Camera, pose: Rigid, *, color: bool) -> Frame:
        """Render one frame."""
        target = self._target(camera.size, color)
        target.use()
        self._gl.clear()
        program, array = self._draw[color]
        program["P"].write(projection(camera).T.astype("f4").tobytes())
        program["V"].write(pose.matrix.T.astype("f4").tobytes())
        array.render()
        shape = (camera.height, camera.width)
        depth = np.frombuffer(target.read(components=1, attachment=0, dtype="f4"), np.float32).reshape(shape)[::-1]
        if not color:
            return None, depth
        image = np.frombuffer(target.read(components=3, attachment=1), np.uint8)
        return image.reshape(*shape, 3)[::-1], depth


class Vtk:
    """A plain vtkRenderWindow, off screen, without multisampling."""

    exact_lens = False

    def __init__(self, mesh: Mesh) -> None:
        vtk, support = module("vtk"), module("vtk.util.numpy_support")
        self._vtk, self._numpy = vtk, support.vtk_to_numpy
        points = vtk.vtkPoints()
        points.SetData(support.numpy_to_vtk(mesh.vertices.astype(np.float32), deep=True))
        cells = vtk.vtkCellArray()
        rows = np.column_stack([np.full(mesh.n_faces, 3), mesh.faces]).astype(np.int64)
        cells.SetCells(mesh.n_faces, support.numpy_to_vtkIdTypeArray(rows.ravel(), deep=True))
        data = vtk.vtkPolyData()
        data.SetPoints(points)
        data.SetPolys(cells)
        mapper = vtk.vtkPolyDataMapper()
        mapper.SetInputData(data)
        actor = vtk.vtkActor()
        actor.SetMapper(mapper)
        actor.GetProperty().SetInterpolationToFlat()
        self._renderer, self._window = vtk.vtkRenderer(), vtk.vtkRenderWindow()
        self._renderer.AddActor(actor)
        self._window.SetOffScreenRendering(1)
        self._window.SetMultiSamples(0)
        self._window.AddRenderer(self._renderer)

    def frame(self, camera: Camera, pose: Rigid, *, color: bool) -> Frame:
        """Render one frame."""
        if tuple(self._window.GetSize()) != camera.size:
            self._window.SetSize(*camera.size)
        eye = self._renderer.GetActiveCamera()
        eye.SetPosition(*pose.origin)
        eye.SetFocalPoint(*(pose.origin + 1000 * pose.rotation[2]))
        eye.SetViewUp(*-pose.rotation[1])
        eye.SetViewAngle(2 * math.degrees(math.atan(camera.height / 2 / camera.fy)))
        eye.SetClippingRange(NEAR, FAR)
        eye.SetWindowCenter(*window_center(camera))
        self._window.Render()
        w, h = camera.size
        values = self._vtk.vtkFloatArray()
        self._window.GetZbufferData(0, 0, w - 1, h - 1, values)
        depth = from_buffer(self._numpy(values).reshape(h, w)[::-1])
        if not color:
            return None, depth
        pixels = self._vtk.vtkUnsignedCharArray()
        self._window.GetPixelData(0, 0, w - 1, h - 1, 0, pixels, 0)
        return self._numpy(pixels).reshape(h, w, 3)[::-1], depth


class Pyvista:
    """pyvista's Plotter, off screen, without anti-aliasing."""

    exact_lens = False

    def __init__(self, mesh: Mesh) -> None:
        self._pyvista = pyvista = module("pyvista")
        rows = np.column_stack([np.full(mesh.n_faces, 3), mesh.faces])
        self._body = pyvista.PolyData(mesh.vertices.astype(np.float32), rows)
        self._plotter: Any = None

    def frame(self, camera: Camera, pose: Rigid, *, color: bool) -> Frame:
        """Render one frame."""
        if self._plotter is None or tuple(self._plotter.window_size) != camera.size:
            self._plotter = self._pyvista.Plotter(off_screen=True, window_size=list(camera.size))
            self._plotter.disable_anti_aliasing()
            self._plotter.add_mesh(self._body, smooth_shading=False)
        eye = self._plotter.camera
        eye.position, eye.focal_point = pose.origin, pose.origin + 1000 * pose.rotation[2]
        eye.up, eye.clipping_range = -pose.rotation[1], (NEAR, FAR)
        eye.view_angle = 2 * math.degrees(math.atan(camera.height / 2 / camera.fy))
        eye.SetWindowCenter(*window_center(camera))
        self._plotter.render()
        if not color:
            return None, -self._plotter.get_image_depth()
        return self._plotter.screenshot(return_img=True), -self._plotter.get_image_depth()


class Pyrender:
    """pyrender's OffscreenRenderer on EGL, in its maintained fork."""

    exact_lens = False

    def __init__(self, mesh: Mesh) -> None:
        os.environ["PYOPENGL_PLATFORM"] = "egl"
        self._pyrender = pyrender = module("pyrender")
        body = module("trimesh").Trimesh(mesh.vertices, mesh.faces, process=False)
        self._scene = pyrender.Scene(ambient_light=[0.3] * 3)
        self._scene.add(pyrender.Mesh.from_trimesh(body, smooth=False))
        self._eye: Any = None
        self._window: Any = None

    def frame(self, camera: Camera, pose: Rigid, *, color: bool) -> Frame:
        """Render one frame."""
        if self._window is None or (self._window.viewport_width, self._window.viewport_height) != camera.size:
            if self._window is not None:
                self._window.delete()  # its context would stay the current one
            self._window = self._pyrender.OffscreenRenderer(*camera.size)
        if self._eye is not None:
            self._scene.remove_node(self._eye)
        matrix = pose.inv.matrix @ np.diag([1.0, -1, -1, 1])
        cx, cy = camera.principal_point
        eye = self._pyrender.IntrinsicsCamera(camera.fx, camera.fy, cx, cy, znear=NEAR, zfar=FAR)
        self._eye = self._scene.add(eye, pose=matrix)
        if not color:
            return None, self._window.render(self._scene, flags=self._pyrender.RenderFlags.DEPTH_ONLY)
        image, depth = self._window.render(self._scene)
        return image, depth


def projection(camera: Camera) -> Array:
    """Return OpenGL's 4x4 of the camera without its lens (docs/conventions.md)."""
    K, (W, H) = camera.K, camera.size
    return np.array(
        [
            [2 * K[0, 0] / W, -2 * K[0, 1] / W, 1 - 2 * (K[0, 2] + 0.5) / W, 0],
            [0, 2 * K[1, 1] / H, 2 * (K[1, 2] + 0.5) / H - 1, 0],
            [0, 0, -(FAR + NEAR) / (FAR - NEAR), -2 * FAR * NEAR / (FAR - NEAR)],
            [0, 0, -1, 0],
        ]
    )


def window_center(camera: Camera) -> tuple[float, float]:
    """Return VTK's shift of the picture for the principal point; it has no skew and one focal length."""
    cx, cy = camera.principal_point
    return 1 - 2 * (cx + 0.5) / camera.width, 2 * (cy + 0.5) / camera.height - 1


def from_buffer(d: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return z in mm of a depth buffer's values in [0, 1]."""
    return np.asarray(FAR * NEAR / (FAR - d * (FAR - NEAR)))


def peer(name: str, mesh: Mesh) -> Peer:
    """Return the renderer of that name for a mesh."""
    if name == "raster, one thread":
        return Raster(mesh, threads=1)
    makers: dict[str, Any] = {
        "raster": Raster,
        "ray": Ray,
        "gl": Gl,
        "moderngl": ModernGL,
        "Open3D": Open3D,
        "Mitsuba": Mitsuba,
        "trimesh + embreex": TrimeshEmbree,
        "VTK": Vtk,
        "pyvista": Pyvista,
        "pyrender": Pyrender,
    }
    made: Peer = makers[name](mesh)
    return made
