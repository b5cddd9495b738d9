"""Lenses: the map from a direction in the camera frame to a point of the normalised image plane, and its inverse.

A lens maps a point p = (x, y, z) of the camera frame to m = (mx, my), dimensionless; the camera matrix K then maps m
to pixels. m is in the *distorted* normalised plane: for the ideal lens m = (x, y)/z. Every lens gives NaN for z <= 0
and outside its valid radius, where its own curve turns back and one image point would have two directions.

All lenses pass the same tests (tests/camera/test_lens.py); a new one is a new row of tests/camera/cameras.py.
"""

from cadcam.camera.lens.axial import AxialLens
from cadcam.camera.lens.base import Lens, PlanarLens
from cadcam.camera.lens.brown_conrady import BrownConrady, TiltedBrownConrady, lens_from_opencv
from cadcam.camera.lens.division import Division
from cadcam.camera.lens.field_of_view import FieldOfView
from cadcam.camera.lens.fisheye import Fisheye
from cadcam.camera.lens.ideal import Ideal
from cadcam.camera.lens.inverse_brown_conrady import InverseBrownConrady
from cadcam.camera.lens.odd_radial import OddRadial
from cadcam.camera.lens.spheres import DoubleSphere, ExtendedUnified

LENSES: dict[str, type[Lens]] = {
    lens.name: lens
    for lens in (
        Ideal,
        BrownConrady,
        TiltedBrownConrady,
        InverseBrownConrady,
        OddRadial,
        Division,
        Fisheye,
        FieldOfView,
        ExtendedUnified,
        DoubleSphere,
    )
}

__all__ = [
    "LENSES",
    "AxialLens",
    "BrownConrady",
    "Division",
    "DoubleSphere",
    "ExtendedUnified",
    "FieldOfView",
    "Fisheye",
    "Ideal",
    "InverseBrownConrady",
    "Lens",
    "OddRadial",
    "PlanarLens",
    "TiltedBrownConrady",
    "lens_from_opencv",
]
