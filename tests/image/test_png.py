"""PNG files written quickly are read by others as what went in."""

from __future__ import annotations

import io
import zlib

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image

from cadcam.cad.parts import machined_bracket
from cadcam.camera.camera import Camera
from cadcam.errors import BadValue, MissingCore
from cadcam.geometry.rigid import Rigid
from cadcam.image.png import DEEPEST, depth_step, packed, packed_depth, packed_normals
from cadcam.native import core
from cadcam.render.raster import RasterRenderer
from cadcam.render.view import Channel, Scene

try:
    core.library()
except MissingCore as error:
    pytest.skip(str(error), allow_module_level=True)

WANTED = Channel.RGB | Channel.DEPTH | Channel.NORMAL
KINDS = [((7, 5), "u1"), ((7, 5, 3), "u1"), ((7, 5), "u2"), ((1, 1), "u2"), ((61, 303, 3), "u1"), ((61, 303), ">u2")]


def samples_of(file: bytes) -> npt.NDArray[np.integer]:
    """Return what Pillow reads in a file."""
    with Image.open(io.BytesIO(file)) as image:
        return np.asarray(image)


def readable(samples: npt.NDArray[np.integer]) -> None:
    """Assert that Pillow reads the file as these samples."""
    np.testing.assert_array_equal(samples_of(packed(samples)), samples)


@pytest.mark.parametrize(("shape", "dtype"), KINDS)
def test_pillow_reads_the_same_samples(rng: np.random.Generator, shape: tuple[int, ...], dtype: str) -> None:
    """Noise, which needs more than it has; nothing; runs of every length; a spot on nothing, whose rows begin anew."""
    noise = rng.integers(0, np.iinfo(dtype).max, shape, endpoint=True).astype(dtype)
    runs = np.repeat(noise, rng.integers(1, 400, noise.shape[1]), axis=1)
    spot = np.zeros_like(noise)
    spot[shape[0] // 3 : -(shape[0] // 3) or None, shape[1] // 2 :] = noise[0, 0] | 1
    for given in (noise, np.zeros_like(noise), noise[:, ::-1], runs, spot):
        readable(given)


def test_codes_of_any_shape_are_read(rng: np.random.Generator) -> None:
    """Bytes as unlike in number as can be: one alone, two, Fibonacci's, whose code would be longer than allowed."""
    fibonacci = [1, 1]
    while sum(fibonacci) < 8000:
        fibonacci.append(fibonacci[-1] + fibonacci[-2])
    for numbers in ([5000], [1, 4000], fibonacci, [1] * 256):
        apart = rng.permuted(np.repeat(np.arange(len(numbers)), numbers)).astype(np.uint8)
        readable(np.stack([apart, np.zeros_like(apart)], axis=-1).reshape(1, -1))  # few runs: no two alike side by side
        readable(apart[None])


def test_opencv_reads_the_same_samples(rng: np.random.Generator) -> None:
    cv2 = pytest.importorskip("cv2", reason='needs the extra: pip install "cadcam[boards]"')
    for shape, dtype in KINDS:
        samples = rng.integers(0, 3, shape).astype(dtype)
        read = cv2.imdecode(np.frombuffer(packed(samples), np.uint8), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(read[..., ::-1] if samples.ndim == 3 else read, samples)


def test_a_rendered_picture_is_packed_as_small_as_zlib_packs_it_quickly() -> None:
    """Depth, normals and colour of a part: within 15 % of zlib's level 1 over the same filtered rows (bytes: runs)."""
    renderer = RasterRenderer(Scene.of(machined_bracket()), threads=1)
    view = renderer.render(
        Camera.from_focal((320, 240), 300.0), Rigid.look_at([200, 180, 160], [60, 40, 30]), channels=WANTED
    )
    for file in (packed_depth(view.depth, 0.05), packed_normals(view.depth, view.normal), packed(view.rgb)):
        samples = samples_of(file)
        rows = samples.astype(samples.dtype.newbyteorder(">")).view(np.uint8).reshape(240, -1)
        less = np.diff(rows.astype(int), axis=0, prepend=0).astype(np.uint8)
        packer = zlib.compressobj(1, strategy=zlib.Z_RLE if samples.dtype == np.uint8 else zlib.Z_DEFAULT_STRATEGY)
        assert packed(samples) == file
        assert len(file) < 1.15 * len(packer.compress(less.tobytes()) + packer.flush())


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1), (23, 37), (64, 64)], ids=str)
def test_depth_is_rounded_to_steps_and_normals_to_bytes_where_there_is_something(
    rng: np.random.Generator, size: tuple[int, int]
) -> None:
    """A step and a half of a byte: each is what it stands for to within half a step."""
    depth = np.where(rng.uniform(size=size) < 0.5, np.inf, rng.uniform(1, 900, size)).astype(np.float32)
    normal = rng.standard_normal((*size, 3)).astype(np.float32)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    there = np.isfinite(depth)
    steps, coded = (
        samples_of(file).astype(float) for file in (packed_depth(depth, 0.05), packed_normals(depth, normal))
    )
    assert np.abs(steps[there] * 0.05 - depth[there]).max(initial=0) <= 0.025 * (1 + 1e-3)
    assert np.abs(coded[there] / 255 * 2 - 1 - normal[there]).max(initial=0) <= 1 / 255 + 1e-6
    assert not steps[~there].any()
    assert not coded[~there].any()


def test_depth_beyond_what_16_bits_hold_is_the_most_they_hold() -> None:
    depth = np.array([[65535.4, 65536, 1e30, 0.4, 0.6]], np.float32)
    assert samples_of(packed_depth(depth, 1.0)).tolist() == [[65535, 65535, 65535, 0, 1]]


@pytest.mark.parametrize(
    "samples", [np.zeros((2, 2)), np.zeros((2, 2, 4), "u1"), np.zeros((0, 2), "u1"), np.zeros(3, "u1")]
)
def test_what_is_no_picture_is_refused(samples: np.ndarray) -> None:
    with pytest.raises(BadValue, match="samples"):
        packed(samples)


@pytest.mark.parametrize("farthest", [2e-4, 0.3, 65.535, 65.536, 810.0, 131070.0, 4e9])
def test_the_step_of_depths_is_the_finest_round_one_that_holds_them(farthest: float) -> None:
    """Of parts smaller than a millimetre, too, which steps of whole micrometres would flatten."""
    step = depth_step(farthest)
    assert farthest / step <= DEEPEST < farthest / step * 2.5 * (1 + 1e-9)  # round steps differ by 2 or 2.5
    assert float(f"{step:.0e}") == pytest.approx(step, rel=1e-12)
