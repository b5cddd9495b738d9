"""The uncertainty predicted for a layout, compared with the scatter of trials: calibrated, rendered, measured.

    python benchmarks/predicted.py [--trials 300] [--places 10] [--only marks,corners,moved]

marks: two cameras over the ship block measure discs of 60 mm on its shell and on the tank top, far out of focus.
corners: four cameras 6 m from a panel measure its corners, each where the lines through two edges meet.
moved: one camera, calibrated once, measures discs from where it stands and, moved by a robot, from a second place.

Predicted (`cadcam.plan`): from cameras, features, light, blur and noise as designed; no picture is looked at. Measured:
each trial calibrates the cameras anew from points with fresh noise, takes pictures through lens and sensor (fresh noise
on pictures rendered with the part in `places` positions, some pixels apart), finds the features (`find_marks`, fitted
steps of brightness) and measures them (`measure_points`); a moved camera errs anew as its robot does. Printed are the
standard deviations over the features' X, Y, Z, the ratios of scatter to prediction, by feature and axis, and the mean
error, which no variance tells of. A ratio over 300 trials has a standard deviation of 0.04.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cadcam.arrays import Array, Picture
from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts import ship_block
from cadcam.calibrate.measure.points import measure_points
from cadcam.camera.aperture import Aperture
from cadcam.camera.camera import Camera
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.extended_pinhole import NAMES
from cadcam.camera.observations import Observations
from cadcam.camera.optics import Optics
from cadcam.camera.sensor_format import sensor_format
from cadcam.camera.viewpoint import KnownMotion, Viewpoint
from cadcam.fit.camera_model import CameraModel
from cadcam.fit.least_squares import cofactor, minimise
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import to_gray
from cadcam.image.profile import step_sums
from cadcam.image.sensor.charge import Exposure
from cadcam.image.sensor.presets import GLOBAL_SHUTTER
from cadcam.image.sensor.video import Gain
from cadcam.native.profiles import StepCells
from cadcam.plan.uncertainty.finding import Finder, circle_covariance
from cadcam.plan.uncertainty.predict import predict_points
from cadcam.render.light import LIGHTS
from cadcam.render.photograph import Photographer, behind, blur_before
from cadcam.render.view import Scene
from cadcam.target.marks.find import find_marks
from cadcam.target.marks.mark import dot

SHORT = 0.25  # of the exposure that makes white of white: what moves must not smear
SENSOR = replace(GLOBAL_SHUTTER, exposure=Exposure(SHORT), gain=Gain(1 / SHORT))
LIGHT = LIGHTS["ring"]
PAPER, INK, STEEL = 0.85, 0.06, 0.35
RADIUS = 30.0  # mm
ROOM = 1.75  # radii of a disc around its middle that are looked at
SAMPLES = 128
REACH, CELL = 12.0, 8.0  # px across and along an edge, to both sides
BEGIN, END = 14.0, 78.0  # px from a corner, between which its edges are used
FREE = tuple(name for name in NAMES if name not in ("aspect", "skew"))
CALIBRATION_PX = 0.05


@dataclass(frozen=True)
class Eye:
    """A camera as it truly is."""

    camera: Camera
    pose: Rigid
    aperture: Aperture

    def calibrated(self, targets: Array, rng: np.random.Generator | None) -> CameraEstimate:
        """Return a calibration from pixels of targets with noise, or, to predict, without; it starts at the truth."""
        q = self.camera.project(self.pose @ targets)
        if rng is not None:
            q = q + CALIBRATION_PX * rng.normal(size=q.shape)
        model = CameraModel(targets, q, FREE, self.camera.lens)
        found = minimise(model, model.state_of(self.camera, self.pose))
        place = np.zeros((len(NAMES), len(FREE)))
        place[[NAMES.index(n) for n in FREE], np.arange(len(FREE))] = 1.0
        observations = Observations(targets, q, sigma_px=CALIBRATION_PX)
        camera = model.camera(found.state, self.camera.size)
        covariance = place @ cofactor(found.jacobian, FREE) @ place.T
        return CameraEstimate(camera, model.pose(found.state), observations, FREE, covariance)

    def blur(self, z: Array) -> Array:
        """Return the sigma in px of all blur of points at depths z: the sensor's, pixel and all, and the disc's."""
        assert SENSOR.blur is not None
        return np.asarray(np.sqrt(SENSOR.blur.sigma_px**2 + self.aperture.defocus_px(self.camera, z) ** 2 / 16))

    def seen(self, cutout: Picture, at: tuple[int, int], rng: np.random.Generator) -> Picture:
        """Return the grey picture of a crop of radiance, with noise."""
        crop = self.camera.crop(*at, (cutout.shape[1], cutout.shape[0]))
        return behind(SENSOR, crop).apply(cutout, rng=rng)


@dataclass(frozen=True)
class Feature:
    """A disc's centre in its plane, z towards where it is seen from; or a corner, the plane's x and y its edges."""

    world_from_feature: Rigid
    disc: bool

    @property
    def point(self) -> Array:
        """Return where it is, mm."""
        return self.world_from_feature.translation


@dataclass(frozen=True)
class Layout:
    """Cameras, what they measure and in which scene. motion: how the last camera came from the first one's place."""

    name: str
    scene: Scene
    eyes: tuple[Eye, ...]
    features: tuple[Feature, ...]
    targets: Array  # points that calibrate
    motion: KnownMotion | None = None
    photographer: Photographer = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "photographer", Photographer(self.scene))

    def viewpoints(self, sigma: Sequence[float], rng: np.random.Generator | None) -> list[Viewpoint]:
        """Return calibrated cameras, in trials with errors of calibration and motion."""
        if self.motion is None:
            estimates = [eye.calibrated(self.targets, rng) for eye in self.eyes]
            return [
                Viewpoint.fixed(f"c{i}", e, sigma_px=s) for i, (e, s) in enumerate(zip(estimates, sigma, strict=True))
            ]
        home, motion = self.eyes[0].calibrated(self.targets, rng), self.motion
        if rng is not None:
            xi = np.linalg.cholesky(motion.covariance) @ rng.normal(size=6)
            motion = KnownMotion(motion.new_from_old @ Rigid.exp(xi), motion.covariance)
        return [
            Viewpoint.fixed("home", home, sigma_px=sigma[0]),
            Viewpoint.moved("away", home, motion, sigma_px=sigma[1]),
        ]

    def noise(self) -> Array:
        """Return the predicted covariance (V, N, 2, 2) px^2 of every feature in every camera."""
        return np.array([[_noise(eye, feature) for feature in self.features] for eye in self.eyes])


def _noise(eye: Eye, feature: Feature) -> Array:
    """Return what plan/finding says of a disc, or of a corner by its two edges."""
    pose = eye.pose @ feature.world_from_feature
    centre = pose.translation
    q, J = eye.camera.project_with_jacobian(centre)
    cosine = float(abs(pose.rotation[:, 2] @ centre) / np.linalg.norm(centre))
    shade = (LIGHT.ambient + LIGHT.flash * cosine) * _vignetting(eye, q)
    light, dark = (PAPER * shade, INK * shade) if feature.disc else (PAPER * shade, STEEL * 0.5 * shade)
    assert SENSOR.noise is not None
    grey = np.hypot(SENSOR.noise.sigma(SHORT * (light + dark) / 2) / SHORT, 1 / 255 / np.sqrt(12))
    finder = Finder(gray=float(grey), contrast=light - dark)
    blur = eye.blur(centre[2])
    if feature.disc:
        return circle_covariance(finder, J @ pose.rotation[:, :2] * RADIUS, blur, sharp_px=blur)
    information = np.zeros((2, 2))
    length = END - BEGIN
    for axis in range(2):  # a line fitted from BEGIN to END, carried on to the corner
        along = J @ pose.rotation[:, axis]
        n = np.array([-along[1], along[0]]) / np.linalg.norm(along)
        variance = (1 + 12 * ((BEGIN + END) / 2 / length) ** 2) / (finder.per_px(blur) * length)
        information += np.outer(n, n) / variance
    return np.asarray(np.linalg.inv(information))


def _vignetting(eye: Eye, q: Array) -> float:
    away = (q - eye.camera.principal_point) / eye.camera.fx
    return float((1 + away @ away) ** -2.0)


def run(layout: Layout, trials: int, places: int, seed: int) -> None:
    """Predict, try, print."""
    noise = layout.noise()
    sigma = np.sqrt(np.trace(noise, axis1=-2, axis2=-1).mean(axis=1) / 2)
    truth = np.array([f.point for f in layout.features])
    predicted = predict_points(layout.viewpoints(sigma, None), truth, noise=noise)
    rng = np.random.default_rng(seed)
    errors, pixels = [], []
    for place in range(places):
        shift = Rigid(translation=rng.uniform(-4.0, 4.0, 3))  # mm: some px, another phase of the grid for each
        crops = [[_crop(layout, eye, f, shift) for f in layout.features] for eye in layout.eyes]
        for _ in range(place, trials, places):
            views = layout.viewpoints(sigma, rng)
            q = np.array(
                [
                    [_found(eye, view, f, shift, crop, rng) for f, crop in zip(layout.features, row, strict=True)]
                    for eye, view, row in zip(layout.eyes, views, crops, strict=True)
                ]
            )
            errors.append(measure_points(views, q).points - shift @ truth)
            true_q = [eye.camera.project(eye.pose @ (shift @ truth)) for eye in layout.eyes]
            pixels.append(q - np.array(true_q))
    report(layout, predicted.sigma, np.array(errors), noise, np.array(pixels))


def _crop(layout: Layout, eye: Eye, feature: Feature, shift: Rigid) -> tuple[tuple[int, int], Picture]:
    """Return the first pixel of a crop around a feature and its grey radiance."""
    pose = eye.pose @ shift @ feature.world_from_feature
    q = eye.camera.project(pose.translation)
    half = int(END) + 12
    if feature.disc:
        half = int(ROOM * RADIUS * eye.camera.fx / pose.translation[2]) + 6
    at = (round(q[0]) - half, round(q[1]) - half)
    crop = eye.camera.crop(*at, (2 * half + 1, 2 * half + 1))
    blur = blur_before(SENSOR, crop, eye.aperture)
    cutout = layout.photographer.radiance(
        crop, eye.pose @ shift, light=LIGHT, aperture=eye.aperture, blur_px=blur, samples=SAMPLES
    )
    return at, to_gray(cutout.over((0.0, 0.0, 0.0)))


def _found(
    eye: Eye,
    view: Viewpoint,
    feature: Feature,
    shift: Rigid,
    crop: tuple[tuple[int, int], Picture],
    rng: np.random.Generator,
) -> Array:
    """Return where a feature is found in a fresh picture of its crop, px of the whole picture."""
    at, radiance = crop
    gray = eye.seen(radiance, at, rng)
    pose = eye.pose @ shift @ feature.world_from_feature
    _, J = eye.camera.project_with_jacobian(pose.translation)
    if feature.disc:
        camera = view.camera.crop(*at, (gray.shape[1], gray.shape[0]))
        size = np.linalg.svd(J @ pose.rotation[:, :2] * RADIUS, compute_uv=False)
        mark = find_marks(
            gray,
            dot(2 * RADIUS),
            radius_px=(0.8 * size[1], 1.2 * size[0]),
            count=1,
            camera=camera,
            normal=pose.rotation[:, 2],
        )[0]
        return mark.pixel + at
    q = eye.camera.project(pose.translation) - at
    lines = [_line(gray, q, J @ pose.rotation[:, axis], float(eye.blur(pose.translation[2]))) for axis in range(2)]
    return np.asarray(np.linalg.solve([n for n, _ in lines], [c for _, c in lines]) + at)


def _line(gray: Picture, corner: Array, along: Array, blur: float) -> tuple[Array, float]:
    """Return n, c of the line n q = c fitted to the steps of brightness beside one edge of a corner."""
    along = along / np.linalg.norm(along)
    normal = np.array([-along[1], along[0]])
    s = np.arange(BEGIN + CELL, END - CELL + 1e-9, 2 * CELL)
    places, reach = corner + s[:, None] * along, np.full(len(s), REACH)
    cells = StepCells(places, np.tile(normal, (len(s), 1)), reach, reach, CELL, blur)
    found = step_sums(gray, cells).solved(np.full((len(s), 2), np.inf))
    slope, offset = np.polyfit(s, -found.moment / found.contrast, 1)
    n = normal - slope * along
    return n, float(n @ corner + offset)


def report(layout: Layout, sigma: Array, errors: Array, noise: Array, pixels: Array) -> None:
    """Print one layout's rows."""
    spread = errors.std(axis=0, ddof=1)
    ratio = spread / sigma
    told = np.sqrt(np.diagonal(noise, axis1=-2, axis2=-1).mean(axis=(1, 2)))
    px = pixels.std(axis=0, ddof=1)
    print(f"\n{layout.name}: {len(errors)} trials, {len(layout.features)} features, {len(layout.eyes)} cameras")
    print("| axis | predicted mm | scatter mm | scatter by prediction, all | least | most | mean error mm |")
    print("|---|---|---|---|---|---|---|")
    for k, axis in enumerate("XYZ"):
        p, s = (float(np.sqrt(np.mean(x[:, k] ** 2))) for x in (sigma, spread))
        mean = float(np.sqrt(np.mean(errors[:, :, k].mean(axis=0) ** 2)))
        each = f"{ratio[:, k].min():.3f} | {ratio[:, k].max():.3f}"
        print(f"| {axis} | {p:.4f} | {s:.4f} | {s / p:.3f} | {each} | {mean:.4f} |")
    by_camera = ", ".join(f"{t:.4f}/{np.sqrt(np.mean(x**2)):.4f}" for t, x in zip(told, px, strict=True))
    print(
        f"\npixels by camera, predicted/scatter: {by_camera}; mean errors up to {np.abs(pixels.mean(axis=0)).max():.4f}"
    )


def over_the_block(places: Sequence[tuple[float, float, float]]) -> tuple[Scene, tuple[Feature, ...]]:
    """Return the ship block with a disc, black on a white sheet, at each place, and the discs."""
    block = ship_block()
    meshes, grey = [block], [STEEL] * len(block.part_names)
    features = []
    for i, place in enumerate(places):
        pose = Rigid(translation=np.array(place))
        turn = np.linspace(0, 2 * np.pi, 97)[:-1]
        circle = RADIUS * np.stack([np.cos(turn), np.sin(turn), np.zeros(96)], axis=1)
        fan = np.stack([np.full(96, 96), np.arange(96), np.roll(np.arange(96), -1)], axis=1)
        sheet = 2.4 * RADIUS * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]])
        meshes.append(Mesh.single(pose @ (sheet - [0, 0, 0.5]), np.array([[0, 1, 2], [0, 2, 3]]), name=f"sheet {i}"))
        meshes.append(Mesh.single(pose @ np.concatenate([circle, np.zeros((1, 3))]), fan, name=f"disc {i}"))
        grey += [PAPER, INK]
        features.append(Feature(pose, disc=True))
    return Scene.of(merge(meshes), colors=np.repeat(np.array(grey)[:, None], 3, axis=1)), tuple(features)


def eye(optics: Optics, place: tuple[float, float, float], at: tuple[float, float, float]) -> Eye:
    """Return a camera at a place that looks at a point."""
    return Eye(optics.camera(), Rigid.look_at(place, at, up=(0.0, 1.0, 0.2)), Aperture.of(optics))


def field_of_points(low: Sequence[float], high: Sequence[float]) -> Array:
    """Return 48 points of a box that calibrate."""
    x, y, z = (np.linspace(a, b, n) for a, b, n in zip(low, high, (4, 4, 3), strict=True))
    return np.stack(np.meshgrid(x, y, z), axis=-1).reshape(-1, 3)


def marks() -> Layout:
    """Return two cameras over the ship block."""
    optics = Optics(sensor_format("IMX273"), 8.0, 4500.0, 1.4)
    top, floor = 2001.0, 13.0
    scene, features = over_the_block(
        [(1000, 1800, top), (3000, 1800, top), (2000, 2000, top), (1080, 800, floor), (2900, 790, floor)]
    )
    eyes = (eye(optics, (600, 300, 6300), (2000, 1400, 900)), eye(optics, (3500, 200, 6500), (2000, 1500, 900)))
    return Layout("marks", scene, eyes, features, field_of_points((300, 300, 100), (3700, 2700, 2000)))


def corners() -> Layout:
    """Return four cameras around a panel, 6 m from its middle."""
    optics = Optics(sensor_format("IMX250"), 16.0, 6000.0, 4.0)
    half = np.array([800.0, 600.0])
    sheet = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    panel = Mesh.single(np.column_stack([sheet, np.zeros(4)]), np.array([[0, 1, 2], [0, 2, 3]]), name="panel")
    floor = Mesh.single(
        np.column_stack([4 * sheet, np.full(4, -300.0)]), np.array([[0, 1, 2], [0, 2, 3]]), name="floor"
    )
    scene = Scene.of(merge([panel, floor]), colors=np.repeat([[PAPER], [STEEL * 0.5]], 3, axis=1))
    features = []
    for sx, sy in ((-1, -1), (1, -1), (1, 1), (-1, 1)):  # edges lead inwards along x and y
        R = np.array([[-sx, 0, 0], [0, -sy, 0], [0, 0, sx * sy]], float)
        features.append(Feature(Rigid(R, np.array([sx * half[0], sy * half[1], 0.0])), disc=False))
    places = [
        (6000 * np.sin(0.5) * np.cos(t), 6000 * np.sin(0.5) * np.sin(t), 6000 * np.cos(0.5))
        for t in (0.7, 2.4, 3.9, 5.6)
    ]
    eyes = tuple(eye(optics, place, (0.0, 0.0, 0.0)) for place in places)
    return Layout("corners", scene, eyes, tuple(features), field_of_points((-900, -700, -200), (900, 700, 600)))


def moved() -> Layout:
    """Return one camera on a robot, and where it is moved to."""
    optics = Optics(sensor_format("IMX273"), 12.0, 3000.0, 2.8)
    scene, features = over_the_block(
        [(500, 1900, 2001.0), (1100, 1900, 2001.0), (800, 2300, 2001.0), (500, 2200, 2001.0)]
    )
    home = eye(optics, (300, 1600, 4700), (800, 2100, 2000))
    away = eye(optics, (1700, 1700, 4500), (800, 2100, 2000))
    motion = KnownMotion(away.pose.inv @ home.pose).known_to(0.15, 1e-4, about=home.pose.origin)
    return Layout(
        "moved", scene, (home, away), features, field_of_points((200, 1500, 1700), (1400, 2700, 2400)), motion
    )


LAYOUTS = {"marks": marks, "corners": corners, "moved": moved}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=300)
    parser.add_argument("--places", type=int, default=10, help="positions of the part among the trials")
    parser.add_argument("--only", default=",".join(LAYOUTS))
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    for name in arguments.only.split(","):
        run(LAYOUTS[name](), arguments.trials, arguments.places, arguments.seed)


if __name__ == "__main__":
    main()
