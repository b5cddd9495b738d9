"""The photos used to evaluate locating: sets with exact poses, noise levels and rough starts, and real photos."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

import overlay_distance
from cadcam.arrays import Array, Picture
from cadcam.cad.read import read_model
from cadcam.camera.camera import Camera
from cadcam.files.camera import read_camera
from cadcam.geometry import rotation
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import read_picture
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.render.view import Scene

SHIP_SIZE = (768, 576)  # of the set that has K.txt only


@dataclass(frozen=True)
class Start:
    """A rough pose camera_from_part of a frame; row: its number in the file."""

    row: int
    frame: int
    pose: Rigid


class PhotoSet:
    """A folder of model.obj (m), camera.json or K.txt, gt.csv, starts.txt, and n<level>/images: exact truth."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.name = folder, folder.name
        own = folder / "camera.json"
        self.camera = read_camera(own).camera if own.exists() else Camera(SHIP_SIZE, np.loadtxt(folder / "K.txt"))
        with (folder / "gt.csv").open() as file:
            self.truth = {int(row["frame"]): _pose(list(row.values())[1:]) for row in csv.DictReader(file)}
        rows = [line.split() for line in (folder / "starts.txt").read_text().splitlines()]
        self.starts = [Start(k, int(row[0]), _pose(row[1:])) for k, row in enumerate(rows)]
        self.noises = sorted(int(path.name[1:]) for path in folder.glob("n[0-9]*"))

    @cached_property
    def part(self) -> Part:
        """The part, made once; what it computes for itself is preparation."""
        return Part(Scene.of(read_model(self.folder / "model.obj", unit="m")))

    @cached_property
    def vertices(self) -> Array:
        """The corners (V, 3) mm of the model."""
        return self.part.scene.mesh.vertices

    @property
    def centroid(self) -> Array:
        """The mean (3,) mm of the corners."""
        return np.asarray(self.vertices.mean(axis=0))

    def gray(self, noise: int, frame: int) -> Picture:
        """Return the grey picture of a frame at a noise level."""
        return read_picture(self.folder / f"n{noise}/images/{frame:04d}.png")

    def photo(self, noise: int, frame: int) -> Photo:
        """Return that picture with its camera; the world is the camera's frame."""
        return Photo.of(self.gray(noise, frame), self.camera, name=f"{self.name} n{noise} {frame}")


@dataclass(frozen=True)
class Case:
    """A part, a photo, and the pose camera_from_part that is right, or as right as the set's reference is."""

    name: str
    part: Part
    photo: Photo
    truth: Rigid


def real_cases(data: Path, most: int) -> list[Case]:
    """Return at most `most` photos from each of the real sets (cube, tea box, triangle) with their references."""
    cases = []
    for photos in (overlay_distance.cube(data), overlay_distance.teabox(data), overlay_distance.triangle(data)):
        part = Part(Scene.of(read_model(photos.model, unit="m")))
        for k in chosen(len(photos.shots), most):
            shot = photos.shots[k]
            photo = Photo.of(read_picture(shot.photo), photos.camera, name=shot.photo.name)
            cases.append(Case(photos.name, part, photo, shot.pose))
    return cases


def exact_cases(photos: PhotoSet, most: int) -> list[Case]:
    """Return at most `most` frames of a set, spread over its noise levels."""
    every = [(noise, frame) for frame in photos.truth for noise in photos.noises]
    return [
        Case(f"{photos.name} n{noise}", photos.part, photos.photo(noise, frame), photos.truth[frame])
        for noise, frame in (every[k] for k in chosen(len(every), most))
    ]


def chosen(n: int, most: int) -> list[int]:
    """Return at most `most` indices spread over n."""
    return sorted({int(k) for k in np.linspace(0, n - 1, min(n, most)).round()})


def _pose(numbers: Sequence[str]) -> Rigid:
    """Return the pose in mm of nine rotation entries, row-major, and three of translation in metres."""
    values = np.array([float(x) for x in numbers])
    return Rigid(rotation.nearest(values[:9].reshape(3, 3)), 1000 * values[9:])
