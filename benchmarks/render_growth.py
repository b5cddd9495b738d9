"""How raster's time grows with triangles (10 thousand to 10 million) and pixels (0.1 to 50 million), and with threads.

    python benchmarks/render_growth.py docs/benchmarks/render_growth.svg   # about five minutes, 4 GB

Colour and z-depth into numpy, from a camera that moves at every frame; medians by wall clock. Prints a Markdown table,
draws it on logarithmic axes, and ends with the pictures a second of a batch of small ones.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cadcam.cad.edges import NO_EDGES
from cadcam.cad.mesh import Mesh
from cadcam.cad.parts import ship_block
from cadcam.render.raster import RasterRenderer
from cadcam.render.view import Channel, Scene
from cadcam.whole import write_whole
from render import LENSES, camera_of, median_frame, pose_of
from render_peers import Raster

TRIANGLES = (10_000, 30_000, 100_000, 300_000, 1_000_000, 3_000_000, 10_000_000)
SIZES = ("364x273", "768x576", "1280x1024", "1920x1080", "3840x2160", "8192x6144")
THREADS = (1, 2)
COLORS = {"": "#1f5fa8", "lens ": "#c2571a"}


class Point(NamedTuple):
    """A measured median in ms: where (triangles or pixels), with which lens, by how many threads."""

    at: float
    lens: str
    threads: int
    ms: float


def block(triangles: int) -> Mesh:
    """Return the ship block with about so many triangles; beyond those it can have, each is cut into four."""
    if triangles <= 2_000_000:
        return ship_block(triangles=triangles)
    coarse = block(triangles // 4)
    corners = coarse.vertices[coarse.faces]
    middles = (corners + np.roll(corners, -1, axis=1)) / 2
    six = np.concatenate([corners, middles], axis=1).reshape(-1, 3)
    cut = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
    return Mesh.single(six, (6 * np.arange(coarse.n_faces)[:, None, None] + cut).reshape(-1, 3))


def measured(mesh: Mesh, size: str, at: float) -> list[Point]:
    """Return the medians of one mesh at one size."""
    points = []
    for threads in THREADS:
        renderer = Raster(mesh, threads=threads)
        for name, lens in LENSES.items():
            ms = median_frame(renderer, camera_of(size, lens), color=True)[0]
            points.append(Point(at, name, threads, ms))
    return points


def by_triangles(counts: Sequence[int]) -> list[Point]:
    """Return the medians at 768x576."""
    meshes = (block(n) for n in counts)
    return [p for mesh in meshes for p in measured(mesh, "768x576", mesh.n_faces)]


def by_pixels(sizes: Sequence[str]) -> list[Point]:
    """Return the medians of 100 000 triangles."""
    mesh = block(100_000)
    return [p for size in sizes for p in measured(mesh, size, math.prod(int(n) for n in size.split("x")))]


def table(points: list[Point], what: str) -> str:
    """Return the medians as Markdown, a row a case."""
    columns = [(lens, threads) for lens in LENSES for threads in THREADS]
    heads = [f"{lens or 'plain '}{n} thread{'s' * (n > 1)}, ms" for lens, n in columns]
    lines = [f"| {what} | {' | '.join(heads)} |", f"|{'---:|' * (len(columns) + 1)}"]
    for at in dict.fromkeys(p.at for p in points):
        row = {(p.lens, p.threads): p.ms for p in points if p.at == at}
        lines.append(f"| {at:,.0f} | {' | '.join(f'{row[c]:.1f}' for c in columns)} |")
    return "\n".join(lines)


def panel(points: list[Point], left: float, title: str) -> list[str]:
    """Return one diagram as SVG elements: 380 x 300 with its corner at (left, 40), both axes logarithmic."""
    x0, x1 = math.floor(math.log10(min(p.at for p in points))), math.ceil(math.log10(max(p.at for p in points)))
    y0, y1 = math.floor(math.log10(min(p.ms for p in points))), math.ceil(math.log10(max(p.ms for p in points)))

    def place(at: float, ms: float) -> tuple[float, float]:
        return left + 380 * (math.log10(at) - x0) / (x1 - x0), 340 - 300 * (math.log10(ms) - y0) / (y1 - y0)

    out = [f'<text x="{left + 190}" y="24" text-anchor="middle" font-weight="bold">{title}</text>']
    for e in range(x0, x1 + 1):
        x, _ = place(10**e, 10**y0)
        out.append(f'<path d="M{x:.1f} 40V340" stroke="#ddd"/>')
        out.append(f'<text x="{x:.1f}" y="358" text-anchor="middle">{_short(10**e)}</text>')
    for e in range(y0, y1 + 1):
        _, y = place(10**x0, 10**e)
        out.append(f'<path d="M{left} {y:.1f}H{left + 380}" stroke="#ddd"/>')
        out.append(f'<text x="{left - 6}" y="{y + 4:.1f}" text-anchor="end">{10**e:g} ms</text>')
    for lens, threads in dict.fromkeys((p.lens, p.threads) for p in points):
        line = [place(p.at, p.ms) for p in points if (p.lens, p.threads) == (lens, threads)]
        path = "M" + " L".join(f"{x:.1f} {y:.1f}" for x, y in line)
        style = f'stroke="{COLORS[lens]}" stroke-width="2" fill="none"' + (' stroke-dasharray="6 3"' * (threads > 1))
        out.append(f'<path d="{path}" {style}/>')
        out.extend(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.5" fill="{COLORS[lens]}"/>' for x, y in line)
    return out


def drawing(triangles: list[Point], pixels: list[Point]) -> str:
    """Return both diagrams and what the lines mean, as one SVG."""
    body = panel(triangles, 70, "triangles, at 768 x 576") + panel(pixels, 540, "pixels, 100 000 triangles")
    for k, (lens, threads) in enumerate((lens, n) for lens in COLORS for n in THREADS):
        dash = ' stroke-dasharray="6 3"' * (threads > 1)
        x = 150 + 190 * k
        words = f"{'with a lens' if lens else 'no distortion'}, {threads} thread{'s' * (threads > 1)}"
        body.append(f'<path d="M{x} 386h30" stroke="{COLORS[lens]}" stroke-width="2"{dash}/>')
        body.append(f'<text x="{x + 36}" y="390">{words}</text>')
    size = 'viewBox="0 0 950 400" width="950" height="400"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size} font-size="12" font-family="sans-serif">'
    return "\n".join([head, '<rect width="950" height="400" fill="white"/>', *body, "</svg>\n"])


def _short(n: int) -> str:
    return f"{n // 1_000_000} M" if n >= 1_000_000 else f"{n // 1000} k"


def batch_rate(pictures: int = 400) -> float:
    """Return how many depth maps of 320x240 a batch renders in a second, of 10 000 triangles."""
    renderer = RasterRenderer(Scene.of(block(10_000), edges=NO_EDGES))
    start = time.perf_counter()
    poses = [pose_of(k) for k in range(pictures)]
    for _ in renderer.render_batch(camera_of("320x240", None), poses, channels=Channel.DEPTH):
        pass
    return pictures / (time.perf_counter() - start)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("svg", type=Path, nargs="?", help="where to draw")
    parser.add_argument("--triangles", type=int, nargs="+", default=TRIANGLES)
    parser.add_argument("--sizes", nargs="+", default=SIZES, help="of the picture, e.g. 768x576")
    arguments = parser.parse_args()
    triangles, pixels = by_triangles(arguments.triangles), by_pixels(arguments.sizes)
    print(table(triangles, "triangles"), table(pixels, "pixels"), sep="\n\n")
    print(f"\nBatch of depth maps, 10 000 triangles at 320x240: {batch_rate():.0f} pictures a second.")
    if arguments.svg:
        write_whole(arguments.svg, drawing(triangles, pixels).encode())


if __name__ == "__main__":
    main()
