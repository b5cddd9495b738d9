"""Three sensors to start from; each number has its reason beside it."""

from __future__ import annotations

from cadcam.image.sensor.charge import Blooming, Noise, Smear
from cadcam.image.sensor.light import Blur, Vignetting
from cadcam.image.sensor.sensor import Sensor
from cadcam.image.sensor.video import EdgeEnhancement, Gain, Gamma, Jitter, Jpeg, Quantization
from cadcam.kinds import expect_known

# The thesis' cameras (section 5): JAI 1/2 inch CCD, CCIR, 768 x 576 by a frame grabber, signal to noise some 50 dB.
CCIR_1996 = Sensor(
    name="ccir-1996",
    vignetting=Vignetting(focal_px=1600.0),  # a 12 mm lens on 6.4 mm in 768 px
    blur=Blur(sigma_px=0.9),  # 5 MHz of video: lines resolve less than pixels
    smear=Smear(5e-4),
    blooming=Blooming(full_well=1.3, drained=0.9),
    noise=Noise(full_well_e=30000.0, read_e=60.0),
    gain=Gain(1.0, black=0.03),
    gamma=Gamma(0.6),  # switched to 1 where it can be: section 5.1
    edge_enhancement=EdgeEnhancement(strength=0.4, radius_px=1.5),
    jitter=Jitter(worst_ns=5.0),  # a digital synchronisation, section 5.3
    quantization=Quantization(8),
)

# A 2.3 to 5 Mpx CMOS of 3.45 um pixels with a global shutter; EMVA 1288 sheets of that class: 10.5 ke-, 2.3 e-.
GLOBAL_SHUTTER = Sensor(
    name="global-shutter",
    vignetting=Vignetting(focal_px=3600.0),  # a 12 mm lens
    blur=Blur(sigma_px=0.6),
    noise=Noise(full_well_e=10500.0, read_e=2.3),
    quantization=Quantization(8),
)

# A small-pixel camera made for the eye: a strong tone curve (near sRGB's 1/2.2), sharpening both ways, JPEG.
PHONE = Sensor(
    name="phone",
    vignetting=Vignetting(focal_px=3000.0, a2=-0.15),
    blur=Blur(sigma_px=0.8),
    noise=Noise(full_well_e=4000.0, read_e=2.0),
    gamma=Gamma(1 / 2.2),
    edge_enhancement=EdgeEnhancement(strength=0.8, radius_px=1.2, vertical=True),
    jpeg=Jpeg(88),
)

PRESETS: dict[str, Sensor] = {s.name: s for s in (CCIR_1996, GLOBAL_SHUTTER, PHONE)}


def preset(name: str) -> Sensor:
    """Return the preset of this name; `UnknownName` with the nearest otherwise."""
    expect_known(name, "sensor", PRESETS)
    return PRESETS[name]
