"""Each effect of a sensor obeys its equation; together they are repeatable, and leave alone what they should."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from cadcam.errors import BadValue, UnknownName
from cadcam.image.sensor import effect
from cadcam.image.sensor.charge import Blooming, Exposure, Noise, Smear
from cadcam.image.sensor.light import Blur, Interlace, Motion, PixelAspect, Vignetting, fit_vignetting, shifted
from cadcam.image.sensor.presets import PRESETS, preset
from cadcam.image.sensor.sensor import EFFECTS, Sensor
from cadcam.image.sensor.video import EdgeEnhancement, Gain, Gamma, Jitter, Jpeg, Quantization

FLOAT32 = float(np.finfo(np.float32).eps)


@pytest.fixture
def scene(rng):
    """Return a picture of smooth blobs between 0.1 and 0.9."""
    from scipy.ndimage import gaussian_filter

    rough = gaussian_filter(rng.standard_normal((60, 80)), 3.0)
    return (0.5 + 0.4 * rough / np.abs(rough).max()).astype(np.float32)


@pytest.mark.parametrize("name", PRESETS)
def test_what_is_computed_in_parts_is_what_is_computed_at_once(name, scene, monkeypatch):
    """Chance too: each effect draws its numbers in the same order. Some of the scene is too bright: wells overflow."""
    sensor, scene = preset(name), 2 * scene
    color = np.stack([scene, 0.5 * scene, scene**2], axis=-1)
    for picture in (scene, color):
        at_once = sensor.apply(picture, rng=np.random.default_rng(3))
        monkeypatch.setattr(effect, "_TOGETHER", 3 * picture[:1].size)
        np.testing.assert_array_equal(sensor.apply(picture, rng=np.random.default_rng(3)), at_once)
        monkeypatch.undo()


@pytest.mark.parametrize("name", PRESETS)
def test_a_sensor_takes_little_memory_beside_the_picture(name, monkeypatch):
    """Bytes a number of the picture: 8 of the electrons, 4 of what is made of them, 4 of the effect before; once 33."""
    monkeypatch.setattr(effect, "_TOGETHER", 1 << 12)
    picture = np.full((300, 400, 3), 0.4, np.float32)
    preset(name).apply(picture[:9, :9], rng=np.random.default_rng(3))  # what is loaded once
    tracemalloc.start()
    out = preset(name).apply(picture, rng=np.random.default_rng(3))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak / picture.size < 8 + 4 + 4 + 8  # 8: blocks
    assert out is not picture
    assert (picture == np.float32(0.4)).all()
    same = Sensor().apply(picture, rng=np.random.default_rng(3))
    assert not np.may_share_memory(same, picture)


def point(shape=(41, 41), value=1.0):
    out = np.zeros(shape, np.float32)
    out[shape[0] // 2, shape[1] // 2] = value
    return out


def centre(picture):
    y, x = np.mgrid[: picture.shape[0], : picture.shape[1]]
    return np.array([(x * picture).sum(), (y * picture).sum()]) / picture.sum()


def spread(picture):
    """Return the second moments (xx, yy, xy) of the light about its centre, px^2."""
    y, x = np.mgrid[: picture.shape[0], : picture.shape[1]]
    dx, dy = x - centre(picture)[0], y - centre(picture)[1]
    return np.array([(dx * dx * picture).sum(), (dy * dy * picture).sum(), (dx * dy * picture).sum()]) / picture.sum()


def test_gamma_is_eq_5_1_and_its_inverse_eq_5_2(golden, rng):
    expected, back = golden("gamma")["value"]
    bent = Gamma(0.6).apply(np.full((1, 1), 128 / 255, np.float32), rng)
    assert 255 * bent[0, 0] == pytest.approx(expected, abs=4 * FLOAT32 * 255)
    assert 255 * Gamma(0.6).undo(bent)[0, 0] == pytest.approx(back, abs=8 * FLOAT32 * 255)


def test_section_5_3_divides_six_nanoseconds_where_five_are_stated(golden):
    stated, divided, pal = golden("jitter")["value"]
    assert Jitter(5.0, 90.0).worst_px == stated
    assert Jitter(6.0, 90.0).worst_px == divided == pytest.approx(golden("jitter")["printed"], abs=0.005)
    assert Jitter(5.0).worst_px == pytest.approx(pal, rel=1e-12)  # the default: 52 us in 768 px


def test_gamma_moves_the_half_level_of_a_blurred_edge_to_the_dark_side_by_as_much_as_it_should(rng):
    """Of an edge Phi(x/s) from 0 to 1, half of the bent scale lies where Phi = 0.5^(1/gamma)."""
    from scipy.special import ndtri

    sigma = 1.5
    edge = np.zeros((3, 60), np.float32)
    edge[:, 30:] = 1.0
    x_edge = 29.5
    bent = Gamma(0.6).apply(Blur(sigma_px=sigma).apply(edge, rng), rng)[1]
    at = np.interp(0.5, bent, np.arange(60))
    assert at - x_edge == pytest.approx(sigma * ndtri(0.5 ** (1 / 0.6)), abs=0.02)  # linear between pixels
    assert at < x_edge - 0.5
    assert np.interp(0.5, Gamma(0.6).undo(bent), np.arange(60)) == pytest.approx(x_edge, abs=0.001)


def test_vignetting_is_the_fourth_power_of_the_cosine_times_a_polynomial():
    V = Vignetting(focal_px=50.0).share((61, 81))
    assert V[30, 40] == 1.0
    assert V[30, 80] == pytest.approx(np.cos(np.arctan(40 / 50)) ** 4, rel=1e-12)
    assert V[0, 40] == pytest.approx(np.cos(np.arctan(30 / 50)) ** 4, rel=1e-12)
    fitted = Vignetting(a2=-0.3).share((61, 81))
    assert fitted[30, 80] == pytest.approx(1 - 0.3 * (40 / np.hypot(30.5, 40.5)) ** 2, rel=1e-12)


def test_the_vignetting_of_a_flat_picture_comes_back_from_a_fit(rng):
    true = Vignetting(a2=-0.4, a4=0.15, a6=-0.05)
    flat = true.apply(np.full((120, 160), 0.8, np.float32), rng)
    found = fit_vignetting(flat)
    assert np.allclose([found.a2, found.a4, found.a6], [-0.4, 0.15, -0.05], atol=1e-5)
    natural = Vignetting(focal_px=200.0).apply(np.full((120, 160), 0.8, np.float32), rng)
    assert np.abs(fit_vignetting(natural).share(flat.shape) - natural / 0.8).max() < 5e-4  # what 5 u^4, u = 1/4, leaves
    with pytest.raises(BadValue, match="evenly lit"):
        fit_vignetting(np.zeros((10, 10)))


def test_blur_keeps_the_light_and_its_place_and_spreads_it_as_its_moments_say(rng):
    blurred = Blur(sigma_px=1.2, defocus_px=4.3).apply(point(), rng)
    assert blurred.sum() == pytest.approx(1.0, abs=1e-5)
    assert np.allclose(centre(blurred), 20, atol=1e-5)
    expected = 1.2**2 + 4.3**2 / 4  # a disc's second moment is r^2/4
    assert np.allclose(spread(blurred)[:2], expected + 1 / 12, atol=0.03)  # shared out to pixels of width 1


@pytest.mark.parametrize("shift", [(3.0, 0.0), (0.0, -5.5), (4.0, 3.0)])
def test_motion_smears_along_its_direction_about_the_middle_of_the_exposure(rng, shift):
    moved = Motion(shift).apply(point(), rng)
    assert moved.sum() == pytest.approx(1.0, abs=1e-5)
    assert np.allclose(centre(moved), 20, atol=1e-5)
    dx, dy = shift
    xx, yy, xy = spread(moved)
    assert xy == pytest.approx(dx * dy / 12, abs=0.01)  # an even segment's moment; the pixels add on the diagonal
    assert xx == pytest.approx(dx * dx / 12, abs=0.26)
    assert yy == pytest.approx(dy * dy / 12, abs=0.26)


def test_motion_of_whole_pixels_is_the_mean_over_the_exposure(rng, scene):
    moved = Motion((4.0, 0.0)).apply(scene, rng)
    fine = np.mean([shifted(scene, (t, 0.0)) for t in np.linspace(-2, 2, 161)], axis=0)
    assert np.abs(moved - fine)[:, 5:-5].max() < 4e-3  # linear against cubic between pixels


def test_interlace_shifts_the_second_field_and_lag_mixes_in_the_one_before(rng, scene):
    woven = Interlace((3.0, 0.0)).apply(scene, rng)
    assert np.array_equal(woven[0::2], scene[0::2])
    assert np.allclose(woven[1::2, 6:-6], scene[1::2, 3:-9], atol=1e-4)
    lagging = Interlace((3.0, 0.0), lag=0.25).apply(scene, rng)
    assert np.allclose(lagging[0::2, 6:-6], 0.75 * scene[0::2, 6:-6] + 0.25 * scene[0::2, 9:-3], atol=1e-4)
    assert np.allclose(lagging[1::2, 6:-6], 0.75 * scene[1::2, 3:-9] + 0.25 * scene[1::2, 6:-6], atol=1e-4)


def test_oblong_pixels_take_the_mean_of_the_light_on_them(rng):
    ramp = np.tile(np.arange(120, dtype=np.float32) / 120, (4, 1))
    ratio = 12 / 11
    out = PixelAspect(ratio).apply(ramp, rng)
    assert out.shape == (4, 110)
    x = np.arange(110)
    assert np.allclose(out, ((x + 0.5) * ratio - 0.5) / 120, atol=0.002 / 120 + 0.12 / 120)  # a staircase of pixels
    assert out.sum() * ratio == pytest.approx(ramp.sum(), rel=1e-5)
    assert PixelAspect(0.5).apply(ramp, rng).shape == (4, 240)


def test_smear_adds_a_share_of_the_columns_mean(rng):
    out = Smear(0.1).apply(point((10, 5), 2.0), rng)
    assert np.allclose(out[:, 2] - point((10, 5), 2.0)[:, 2], 0.1 * 2.0 / 10)
    assert not out[:, 1].any()


def test_blooming_keeps_charge_fills_its_column_evenly_and_leaves_no_pixel_over_full(rng):
    out = Blooming().apply(point((41, 5), 6.0), rng)
    assert out.max() == 1.0
    assert out.sum() == pytest.approx(6.0, abs=1e-5)
    assert np.allclose(out[:, 2], out[::-1, 2])
    assert out[:, 2].tolist().count(1.0) == 5  # itself, two above, two below; a half in the next
    drained = Blooming(drained=0.6).apply(point((41, 5), 6.0), rng)
    assert drained.sum() == pytest.approx(1.0 + 0.4 * 5.0, abs=1e-5)
    assert Blooming(full_well=1.0).apply(point((5, 5), 100.0), rng).sum() == pytest.approx(5.0)  # the rest is lost


@pytest.mark.parametrize("level", [0.0, 0.01, 0.9])
def test_noise_has_the_variance_of_photons_and_amplifier(rng, level):
    noise = Noise(full_well_e=5000.0, read_e=20.0)
    out = noise.apply(np.full((300, 400), level, np.float32), rng).astype(float)
    n = out.size
    assert abs(out.mean() - level) < 4 * noise.sigma(level) / np.sqrt(n)
    assert abs(out.std() / noise.sigma(level) - 1) < 4 / np.sqrt(2 * n) * 1.2


def test_gain_amplifies_noise_with_the_signal(rng):
    flat = np.full((100, 100), 0.1, np.float32)
    noise = Noise(20000.0, 30.0)
    noisy = Gain(4.0, black=0.02).apply(noise.apply(flat, rng), rng)
    assert noisy.mean() == pytest.approx(0.42, abs=4 * 4 * noise.sigma(0.1) / 100)
    assert noisy.std() == pytest.approx(4 * noise.sigma(0.1), rel=0.04)


def test_edge_enhancement_overshoots_on_both_sides_of_an_edge_and_nowhere_else(rng):
    edge = np.full((5, 60), 0.3, np.float32)
    edge[:, 30:] = 0.7
    out = EdgeEnhancement(strength=0.5, radius_px=1.5).apply(edge, rng)
    assert out[2, 29] < 0.3 - 0.05
    assert out[2, 30] > 0.7 + 0.05
    assert np.allclose(out[2, 29] + out[2, 30], 1.0, atol=1e-6)
    assert np.allclose(out[2, :15], 0.3, atol=1e-6)
    assert np.allclose(EdgeEnhancement(0.5).apply(edge.T.copy(), rng), edge.T)  # along lines only
    both = EdgeEnhancement(0.5, vertical=True)
    assert np.allclose(both.apply(edge.T.copy(), rng).T, both.apply(edge, rng), atol=1e-6)


def test_jitter_shifts_whole_lines_by_no_more_than_its_worst(rng, scene):
    jitter = Jitter(worst_ns=40.0, pixel_ns=67.7)
    blob = np.exp(-0.5 * ((np.arange(80) - 40) / 3.0) ** 2).astype(np.float32)
    out = jitter.apply(np.tile(blob, (400, 1)), rng)
    at = (out * np.arange(80)).sum(axis=1) / out.sum(axis=1) - 40
    assert np.abs(at).max() < jitter.worst_px + 1e-3
    sigma = jitter.worst_px / np.sqrt(3)
    assert at.std() == pytest.approx(sigma, rel=4 * 0.45 / np.sqrt(400))  # the relative sd of an even draw's sd
    color = np.stack([scene] * 3, axis=-1)
    shifted_color = jitter.apply(color, np.random.default_rng(3))
    assert np.array_equal(shifted_color[..., 0], shifted_color[..., 2])


def test_quantization_rounds_to_its_steps(rng, scene):
    out = Quantization(6).apply(scene, rng)
    assert np.allclose(out * 63, np.rint(out * 63), atol=1e-4)
    assert np.abs(out - scene).max() <= 0.5 / 63 + 1e-6


def test_jpeg_loses_more_the_lower_its_quality(rng, scene):
    loss = [np.abs(Jpeg(quality).apply(scene, rng) - scene).max() for quality in (95, 60, 10)]
    assert loss[0] < loss[1] < loss[2]
    assert loss[0] < 0.03


def test_a_sensor_without_effects_only_clips(scene):
    assert np.array_equal(Sensor().apply(scene, rng=np.random.default_rng(0)), scene)
    assert Sensor().apply(2 * scene, rng=np.random.default_rng(0)).max() == 1.0


@pytest.mark.parametrize("name", PRESETS)
def test_the_same_seed_gives_the_same_picture_and_another_seed_another(name, scene):
    first, again, other = (preset(name).apply(scene, rng=np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    assert first.min() >= 0
    assert first.max() <= 1
    assert first.dtype == np.float32


def test_an_effect_less_leaves_the_noise_of_the_others_as_it_was(scene):
    jitter = Jitter(20.0)
    with_both = Sensor(noise=Noise(1e8), jitter=jitter).apply(scene, rng=np.random.default_rng(5))
    alone = Sensor(jitter=jitter).apply(scene, rng=np.random.default_rng(5))
    assert np.abs(alone - scene).max() > 0.01
    assert np.abs(with_both - alone).max() < 10 / np.sqrt(1e8)  # ten sigma of the noise


def test_effects_act_in_the_order_of_nature_whatever_order_they_are_named_in():
    sensor = Sensor(jpeg=Jpeg(), gamma=Gamma(0.6), noise=Noise(), exposure=Exposure(2.0), blur=Blur(1.0))
    assert list(sensor.effects) == ["blur", "exposure", "noise", "gamma", "jpeg"]
    assert list(EFFECTS) == [f for f in Sensor.__dataclass_fields__ if f != "name"]


def test_numbers_out_of_range_are_refused():
    for make, what in (
        (lambda: Gamma(0.0), "gamma"),
        (lambda: Gamma(float("nan")), "gamma"),
        (lambda: Noise(-5.0), "full_well_e"),
        (lambda: Blur(sigma_px=-1.0), "sigma_px"),
        (lambda: Jitter(5.0, 0.0), "pixel_ns"),
        (lambda: Quantization(0), "bits"),
        (lambda: Quantization(float("nan")), "bits of the quantization is nan; expected a whole number from 1 to 16"),
        (lambda: Quantization("8"), "bits"),
        (lambda: Jpeg(101), "quality"),
        (lambda: Jpeg(float("inf")), "quality"),
        (lambda: Exposure(0.0), "exposure"),
        (lambda: Motion((np.inf, 0.0)), "shift_px"),
        (lambda: Interlace(lag=1.5), "lag"),
        (lambda: PixelAspect(0.0), "ratio"),
        (lambda: Blooming(full_well=0.0), "full_well"),
    ):
        with pytest.raises(BadValue, match=what):
            make()
    with pytest.raises(UnknownName, match="did you mean 'phone'"):
        preset("phones")


def test_a_vignetting_that_is_no_number_and_a_picture_narrower_than_a_pixel_are_refused(rng):
    with pytest.raises(BadValue, match="a4 of the vignetting is nan; expected a finite number"):
        Vignetting(a4=float("nan"))
    with pytest.raises(BadValue, match="picture is 5 px wide; expected 10 px or more"):
        PixelAspect(10.0).apply(np.ones((4, 5), np.float32), rng)
