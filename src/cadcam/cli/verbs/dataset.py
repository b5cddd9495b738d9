"""`cadcam dataset`: a CAD model -> labelled synthetic pictures in BOP's and COCO's formats."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import Verbs, add_json, real, reals, seed, size, span, verb, whole
from cadcam.cli.models import add_model_options, load_as_asked, model_as_json
from cadcam.cli.output import check_folder, print_json, print_tables, progress, say, working

if TYPE_CHECKING:
    from cadcam.dataset.make import Made

_EXAMPLES = """\
  cadcam dataset part.step -o set --count 1000 --seed 1
  cadcam dataset part.stl -o set --count 5000 --seen-from above:70 --backgrounds noise photos/ --occluders 0,3
  cadcam dataset part.step -o set --camera camera.json --sensor global-shutter --gray --key-points points.csv
  cadcam dataset part.step -o set --camera camera.json --poses poses.csv
  cadcam dataset part.step -o set --plan plan.yaml --split val --seed 2
  cadcam dataset part.step -o set --count 1000000 --cluster tcp://10.0.0.1:8786

what is written: a BOP data set (SPLIT/000000/rgb, depth, mask, mask_visib, scene_camera.json, scene_gt.json,
scene_gt_info.json; models/; camera.json), SPLIT_coco.json, and beside them edges/ (visible edges as polylines with the
numbers of the part's edges), normal/, and view/ (key points, camera with its lens, light, occluders). contact.png shows
twelve views with their labels drawn: look at it first.

the same command gives the same bytes: each view depends on --seed and its own number alone, not on --workers, the
cluster or interruptions. Run it again and it goes on where it was stopped; with more --count it adds to what is there.

a range A,B is drawn evenly for each view; one number is fixed. Everything can stand in a plan file, in YAML, keys named
as the options, with their unit (--occluder-size: occluder_size, --roll: roll_deg); options go before it:
  count: 1000
  seen_from: above:70
  backgrounds: [plain, noise, photos/]
  occluders: [0, 3]

--seen-from  any (default), above, above:DEG or X,Y,Z:DEG: towards the camera in the part's axes, and how far around
--roll       how far --up may stand from upright in the picture (default 180: any turn)

occluders hide the part and are not labelled. Depth is in steps of depth_scale mm, 0 where there is nothing.
"""
_DESCRIPTION = """\
Render many labelled views of a part, on all cores or on a cluster: poses, lights, backgrounds, occluders and the
camera's noise drawn at random, every label exact."""


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
    short = "CAD model -> any number of labelled synthetic pictures (BOP, COCO)"
    parser = verb(verbs, "dataset", run, short=short, description=_DESCRIPTION, examples=_EXAMPLES)
    add_model_options(parser)
    parser.add_argument("-o", "--output", metavar="FOLDER", required=True, help="folder of the data set")
    parser.add_argument("--count", type=whole, metavar="N", help="how many pictures (default 100, or one per pose)")
    parser.add_argument(
        "--seed", type=seed, metavar="N", help="seed of the random numbers: another one, another data set (default 0)"
    )
    parser.add_argument("--plan", metavar="FILE", help="plan file: YAML, see below")
    _add_seeing(parser.add_argument_group("camera and where it stands"))
    _add_looks(parser.add_argument_group("what it sees"))
    group = parser.add_argument_group("how it is made")
    group.add_argument("--split", default="train", metavar="NAME", help="BOP's name of the set (default train)")
    group.add_argument("--workers", type=whole, metavar="N", help="how many processes (default: one per core)")
    group.add_argument("--cluster", metavar="ADDRESS", help="address of a Dask scheduler, instead of processes")
    parser.set_defaults(resumes=True)
    add_json(parser)


def _add_seeing(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--camera", metavar="FILE", help="camera file, including its lens")
    group.add_argument("--size", type=size, metavar="WxH", help="without a camera: picture size (default 640x480)")
    group.add_argument(
        "--view-angle",
        type=real,
        metavar="DEG",
        help="without a camera: angle of view over the shorter side (default 40)",
    )
    group.add_argument(
        "--focal-jitter", type=real, metavar="PERCENT", help="sigma of the focal length, by view (default 0)"
    )
    group.add_argument("--center-jitter", type=real, metavar="PX", help="sigma of the principal point (default 0)")
    group.add_argument("--seen-from", metavar="V", help="from where the part is seen (below; default any)")
    group.add_argument("--up", type=reals, metavar="X,Y,Z", help="what is up, in the part's axes (default 0,0,1)")
    group.add_argument(
        "--roll", type=real, metavar="DEG", help="how far --up may be from upright in the picture (default 180)"
    )
    group.add_argument(
        "--fill",
        type=span,
        metavar="A,B",
        help="size of the part by the picture's shorter side, at most 2 (default 0.4,0.9)",
    )
    group.add_argument(
        "--distance",
        type=span,
        metavar="NEAR,FAR",
        help="range of the camera's distance from the part's middle, mm; instead of --fill",
    )
    group.add_argument(
        "--off-center",
        type=real,
        metavar="S",
        help="how far the part may be off the middle, by the shorter side (default 0.1)",
    )
    group.add_argument("--poses", metavar="FILE", help="camera_from_part of each view: a poses file of `cadcam render`")


def _add_looks(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--head", type=span, metavar="A,B", help="strength of the light at the camera (default 0.1,0.5)")
    group.add_argument(
        "--distant", type=span, metavar="A,B", help="strength of two lights from anywhere (default 0.1,0.5)"
    )
    group.add_argument(
        "--ambient", type=span, metavar="A,B", help="strength of light without direction (default 0.1,0.3)"
    )
    group.add_argument(
        "--backgrounds",
        nargs="+",
        metavar="B",
        help="what is behind the part, one of them a view: plain (default), noise, photos, folders of photos",
    )
    group.add_argument(
        "--occluders",
        type=span,
        metavar="N,M",
        help="how many things hide the part, fewest and most per view (default 0)",
    )
    group.add_argument(
        "--occluder-shapes",
        nargs="+",
        metavar="S",
        help="what they are: box, cylinder, CAD files (default the first two)",
    )
    group.add_argument(
        "--occluder-size",
        type=span,
        metavar="A,B",
        help="size of boxes and cylinders by the part's diameter (default 0.1,0.3)",
    )
    group.add_argument(
        "--sensor",
        metavar="PROFILE",
        help="what the camera does to the picture: a file or a preset (`cadcam sensor`; default: ideal)",
    )
    group.add_argument("--samples", type=whole, metavar="N", help="N x N rays per pixel (default 2)")
    group.add_argument("--gray", action="store_true", default=None, help="grey pictures")
    group.add_argument("--key-points", metavar="FILE", help="name, X, Y, Z of the points to label (default: corners)")


def run(arguments: argparse.Namespace) -> None:
    """Make the data set, or continue it; report the result."""
    from cadcam.dataset.plan_file import read_plan

    check_folder(arguments.output)
    plan = read_plan(arguments.plan, _options(arguments))
    if plan.camera.lens.parameters:
        say("pictures and labels are as seen through a lens, for which BOP has no place: it stands in view/*.json")
    mesh, report = load_as_asked(arguments)
    with working("looking for edges"):
        from cadcam.dataset.make import make_dataset
        from cadcam.render.view import Scene

        scene = Scene.of(mesh)
    with _bar(arguments) as (on_start, on_view):
        made = make_dataset(
            arguments.output,
            scene,
            plan,
            name=Path(arguments.model).stem,
            split=arguments.split,
            workers=arguments.workers,
            cluster=arguments.cluster,
            on_start=on_start,
            on_view=on_view,
        )
    if arguments.json:
        print_json(_as_json(made) | {"model": model_as_json(report, mesh)})
        return
    from cadcam.report.dataset import summary

    print_tables([summary(made)])
    if not any(made.visible):
        said = "do the poses put the part before the camera, in mm?" if plan.poses else "is it always hidden?"
        say(f"no picture shows anything of the part: {said}")
    say(f"wrote {made.folder}; look at {shlex.quote(str(made.contact))}")


def _options(arguments: argparse.Namespace) -> dict[str, Any]:
    from cadcam.dataset.plan_file import KEYS, option_of

    named = {key: getattr(arguments, option_of(key).lstrip("-").replace("-", "_")) for key in KEYS}
    given = {key: value for key, value in named.items() if value is not None}
    return {key: list(value) if isinstance(value, tuple) else value for key, value in given.items()}


@contextmanager
def _bar(arguments: argparse.Namespace) -> Iterator[tuple[Any, Any]]:
    """Yield a function that takes the number of views, and one that is called after each."""
    with ExitStack() as stack:
        step: list[Any] = []

        def start(todo: int, there: int) -> None:
            if there and not arguments.json:
                say(f"{there} views are in {arguments.output}; going on")
            step.append(stack.enter_context(progress("rendering", todo)))

        yield start, lambda: step[0]()


def _as_json(made: Made) -> dict[str, Any]:
    return {
        "output": str(made.folder),
        "views": len(made.visible),
        "new": made.new,
        "shown": sum(share > 0 for share in made.visible),
        "depth_scale": made.depth_step,
        "bop": [str(made.folder / scene) for scene in made.scenes],
        "coco": str(made.folder / made.layout.coco),
        "contact": str(made.contact),
    }
