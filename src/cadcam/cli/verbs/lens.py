"""`cadcam lens`: the lens for a view: focal length, distance, field of view, depth of field."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from cadcam.cli.arguments import Verbs, add_json, given, real, size, verb
from cadcam.cli.output import check_target, print_json, print_tables, say, say_written
from cadcam.errors import BadValue

if TYPE_CHECKING:
    from cadcam.camera.sensor_format import SensorFormat

_EXAMPLES = """\
  cadcam lens --sensor-size 1/2 --field-width 2000 --focus 6000       which lens sees 2 m at 6 m?
  cadcam lens --sensor-size IMX264 --focal 16 --focus 1500 --f-number 8
  cadcam lens --sensor-size 2/3 --focal 25 --field-width 800                 from how far away?
  cadcam lens --sensor-size 1/2 --size 768x576 --effective --focal 16 --focus 6000 --diagram lenses.png
  cadcam lens --list                                                       sensors known by name
"""
_DESCRIPTION = """\
Solve the lens formula: from two of focal length, distance and width of the field, find the third. Printed are field of
view, viewing angle, size of a pixel on the object and, with an f-number, depth of field (blur of a pixel at
most) and diffraction. For a focal length that no maker offers, the next shorter and longer lenses are shown as well."""


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
    short = "sensor + two of focal length, distance, width -> the rest"
    parser = verb(verbs, "lens", run, short=short, description=_DESCRIPTION, examples=_EXAMPLES)
    parser.add_argument(
        "--sensor-size", metavar="SIZE", help="the sensor: format (1/2), chip (IMX264) or its size in mm (5.94x3.96)"
    )
    parser.add_argument(
        "--size", type=size, metavar="WxH", help="picture size in px, where the sensor's name does not say"
    )
    parser.add_argument(
        "--effective", action="store_true", help="use nine tenths of the sensor's width and height only"
    )
    parser.add_argument("--focal", type=real, metavar="MM", help="focal length")
    parser.add_argument("--focus", type=real, metavar="MM", help="distance in focus, from the lens")
    parser.add_argument("--field-width", type=real, metavar="MM", help="width of what is seen at that distance")
    parser.add_argument(
        "--mm-per-pixel", type=real, metavar="MM", help="size of a pixel on the object, instead of --field-width"
    )
    parser.add_argument(
        "--f-number", type=real, metavar="N", help="focal length divided by the diameter of the aperture"
    )
    parser.add_argument(
        "--image-circle", type=real, metavar="MM", help="diameter of the lens' image circle: does it cover the sensor?"
    )
    parser.add_argument(
        "--speed", type=real, metavar="MM/S", help="speed of the object: the longest exposure without smear is printed"
    )
    parser.add_argument("--diagram", metavar="FILE", help="lens-selection diagram of this sensor: .png, .svg, .pdf")
    parser.add_argument("--list", action="store_true", help="list the sensors known by name")
    add_json(parser)


def run(arguments: argparse.Namespace) -> None:
    """Solve, print, draw."""
    from cadcam.camera.optics import solve_optics, standard_lenses
    from cadcam.report.lens import formats_as_json, formats_table, lens_as_json, lens_table, write_lens_diagram

    if arguments.list:
        if arguments.json:
            print_json(formats_as_json())
        else:
            print_tables([formats_table()])
        return
    check_target(arguments.diagram, (".png", ".svg", ".pdf"))
    sensor = _sensor(arguments)
    _check_two(arguments)
    optics = solve_optics(
        sensor,
        focal_mm=arguments.focal,
        distance_mm=arguments.focus,
        width_mm=_width(arguments, sensor),
        f_number=arguments.f_number,
        image_circle_mm=arguments.image_circle,
    )
    others = standard_lenses(optics) if arguments.focal is None else ()
    if arguments.diagram:
        write_lens_diagram(arguments.diagram, sensor, chosen=optics)
    exposure_s = None if arguments.speed is None else optics.longest_exposure_s(arguments.speed, 0.5)
    if arguments.json:
        motion = {} if exposure_s is None else {"longest_exposure_s": exposure_s}
        print_json(lens_as_json(optics) | motion | {"standard_lenses": [lens_as_json(o) for o in others]})
    else:
        print_tables([lens_table(o) for o in (optics, *others)])
        if exposure_s is not None:
            say(f"smear below half a pixel at {arguments.speed:g} mm/s: up to {exposure_s:.3g} s")
    say_written(arguments.diagram)


def _check_two(arguments: argparse.Namespace) -> None:
    """Refuse fewer or more than two of the three that the lens formula ties."""
    known = given(arguments, "--focal", "--focus", "--field-width", "--mm-per-pixel")
    if len(known) != 2 and not {"--field-width", "--mm-per-pixel"} <= set(known):
        two = "two of --focal, --focus and --field-width (or --mm-per-pixel)"
        raise BadValue("what is known of the lens", ", ".join(known) or "nothing", two)


def _sensor(arguments: argparse.Namespace) -> SensorFormat:
    from cadcam.camera.sensor_format import sensor_format

    if arguments.sensor_size is None:
        raise BadValue(
            "--sensor-size", "not given", "one: a format such as 1/2, a chip such as IMX264, or its size in mm"
        )
    sensor = sensor_format(arguments.sensor_size)
    if arguments.effective and sensor.pixels is not None and arguments.size is None:
        chip = f"given with {sensor.name}, all of whose pixels are used"
        raise BadValue("--effective", chip, "a format such as 1/2, or --size WxH: those of the part that is used")
    if arguments.size is not None:
        sensor = sensor.with_pixels(arguments.size)
    return sensor.effective() if arguments.effective else sensor


def _width(arguments: argparse.Namespace, sensor: SensorFormat) -> float | None:
    if arguments.mm_per_pixel is None:
        width: float | None = arguments.field_width
        return width
    if arguments.field_width is not None:
        raise BadValue("--mm-per-pixel", "given beside --field-width", "one of them")
    return float(arguments.mm_per_pixel * sensor.size_mm[0] / sensor.pitch_mm[0])
