"""`cadcam sensor`: the effects of a camera on a picture, from a profile: noise, blur, gamma, jitter and the rest."""

from __future__ import annotations

import argparse
from pathlib import Path

from cadcam.cli.arguments import Verbs, add_jobs, job, real, seed, verb
from cadcam.cli.output import check_target, print_json, say, say_written
from cadcam.cli.sensors import generator
from cadcam.errors import BadValue
from cadcam.image.suffixes import READABLE, WRITABLE

_EXAMPLES = """\
  cadcam sensor show                                        the presets, and every effect with its numbers
  cadcam sensor show ccir-1996 -o hall.json                 a profile to change with an editor
  cadcam sensor apply hall.json clean.png -o as_seen.png
  cadcam sensor apply global-shutter photo.png --linearize 0.45 --seed 7 -o noisy.png
  cadcam render part.step --camera camera.json --sensor phone -o part.jpg

profile file: JSON; an effect that is left out does not happen, a number left out has its default
  {"format": "cadcam sensor", "version": 1, "name": "hall",
   "blur": {"sigma_px": 0.8}, "noise": {"full_well_e": 20000, "read_e": 12}, "gamma": {"gamma": 0.6}}
"""
_DESCRIPTION = """\
Simulate what a camera makes of a clean picture. Its values are taken as linear radiance, its white as the scene's;
effects are applied in their physical order: vignetting, blur, motion, interlace, pixel_aspect (light), exposure, smear,
blooming, noise (charge), gain, gamma, edge_enhancement, jitter, quantization, jpeg (signal). The same seed gives the
same picture. PROFILE is a file or a preset: ccir-1996 (analogue video with a frame grabber), global-shutter (machine
vision), phone."""


def add_to(verbs: Verbs) -> None:
    """Add the verb and its two jobs."""
    short = "what a camera does to a picture: noise, blur, gamma, jitter ..."
    parser = verb(verbs, "sensor", None, short=short, description=_DESCRIPTION, examples=_EXAMPLES)
    jobs = add_jobs(parser)
    show = job(jobs, "show", run_show, short="print a profile (JSON), or list presets and effects")
    show.add_argument("profile", metavar="PROFILE", nargs="?", help="file or preset; without it: presets and effects")
    show.add_argument("-o", "--output", metavar="FILE", help="write the profile to this .json")
    apply = job(jobs, "apply", run_apply, short="picture -> what the sensor makes of it")
    apply.add_argument("profile", metavar="PROFILE", help="file or preset")
    apply.add_argument("image", metavar="IMAGE", help="picture, linear in radiance (renderings are taken as such)")
    apply.add_argument("-o", "--output", metavar="FILE", required=True, help="picture to write (.png or .jpg)")
    apply.add_argument("--seed", type=seed, default=0, metavar="N", help="of the noise (default: 0)")
    apply.add_argument(
        "--linearize", type=real, metavar="GAMMA", help="undo this gamma of the image first: 0.45 for most photos"
    )


def run_show(arguments: argparse.Namespace) -> None:
    """Print a profile in the form of its file, or the presets and all effects with their defaults."""
    from cadcam.files.sensor import named_sensor, sensor_as_json, write_sensor

    if arguments.output is not None:
        if arguments.profile is None:
            raise BadValue("-o", "given without a profile", "which one: cadcam sensor show ccir-1996 -o FILE")
        check_target(arguments.output, (".json",))
        write_sensor(arguments.output, named_sensor(arguments.profile))
        say_written(arguments.output)
    elif arguments.profile is not None:
        print_json(sensor_as_json(named_sensor(arguments.profile)))
    else:
        _list()


def _list() -> None:
    from cadcam.image.sensor.presets import PRESETS
    from cadcam.image.sensor.sensor import EFFECTS

    print("presets:")
    for name, sensor in PRESETS.items():
        print(f"  {name:16s}{', '.join(sensor.effects)}")
    print("effects, in their order, with the numbers of each and their defaults:")
    for name, kind in EFFECTS.items():
        numbers = ", ".join(f"{key} {value}" for key, value in _defaults(kind).items())
        first, *_ = (kind.__doc__ or "").split("\n")  # python -OO has none
        print(f"  {name:18s}{first}\n  {'':18s}({numbers})")


def _defaults(kind: type) -> dict[str, str]:
    from dataclasses import fields

    return {f.name: f"{f.default:g}" if isinstance(f.default, float) else str(f.default) for f in fields(kind)}


def run_apply(arguments: argparse.Namespace) -> None:
    """Read, apply, write."""
    from cadcam.files.sensor import named_sensor
    from cadcam.image.picture import read_picture, write_picture
    from cadcam.image.sensor.video import Gamma

    check_target(arguments.output, WRITABLE)
    if Path(arguments.profile).suffix.lower() in READABLE:
        first = f"the profile first, then the picture (now {arguments.image!r})"
        raise BadValue("PROFILE", f"{arguments.profile!r}, a picture", first)
    sensor = named_sensor(arguments.profile)
    picture = read_picture(arguments.image)
    if arguments.linearize is not None:
        picture = Gamma(arguments.linearize).undo(picture)
    out = sensor.apply(picture, rng=generator(arguments.seed))
    write_picture(arguments.output, out)
    say(f"wrote {arguments.output} ({out.shape[1]} x {out.shape[0]} px): {sensor.name}: {', '.join(sensor.effects)}")
