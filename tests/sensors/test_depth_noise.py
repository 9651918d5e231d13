"""Noise models against their published numbers and against simulated disparities."""

import numpy as np
import pytest

from tests.kit import InputError, refuses
from ttus_opt.sensors.depth_noise import (
    Pixels,
    Stereo,
    StructuredLight,
    TimeOfFlight,
    noise_model,
)


def pixels(z, angle=0.0, off_axis=1.0):
    each = np.array([z])
    return Pixels(each, off_axis * each, np.array([np.deg2rad(angle)]), 600.0)


def test_structured_light_as_published():
    """Nguyen et al. 2012, eq. 3: millimetres at a few depths and angles, by hand."""
    model = StructuredLight()
    for z, angle, expected in (
        (0.4, 0, 1.2e-3),
        (1.0, 0, 1.884e-3),  # 1.2 + 1.9 · 0.36
        (2.4, 0, 8.8e-3),  # 1.2 + 1.9 · 4
        (1.0, 45, 1.984e-3),  # θ = π/2 − θ: 0.1 mm more
        (1.0, 60, 2.284e-3),  # (θ/(π/2 − θ))² = 4
    ):
        np.testing.assert_allclose(model.along_ray(pixels(z, angle)), expected)
    steep = [model.along_ray(pixels(1.0, angle))[0] for angle in (80.0, 89.999, 90.0)]
    np.testing.assert_allclose(steep, steep[0])
    assert model.along_ray(pixels(0.1)) == model.along_ray(pixels(0.4))
    off = model.along_ray(pixels(1.0, off_axis=1.2))
    np.testing.assert_allclose(off, 1.2 * 1.884e-3)


@pytest.mark.parametrize("z", [0.5, 1.0, 2.0])
def test_stereo_is_the_scatter_of_noisy_disparities(z):
    rng = np.random.default_rng(0)
    baseline, std, focal = 0.05, 0.1, 600.0
    disparity = focal * baseline / z + std * rng.standard_normal(200_000)
    scatter = np.std(focal * baseline / disparity)
    predicted = Stereo(baseline, std).along_ray(pixels(z))
    np.testing.assert_allclose(predicted, scatter, rtol=0.01)


def test_time_of_flight_is_what_is_stated():
    assert TimeOfFlight(0.004).along_ray(pixels(2.0, 70.0, 1.3)) == 0.004


def test_by_name():
    assert noise_model("structured-light") == StructuredLight()
    assert noise_model("stereo:0.05") == Stereo(0.05, 0.1)
    assert noise_model(" Stereo:0.05,0.2") == Stereo(0.05, 0.2)
    assert noise_model("time-of-flight:0.003") == TimeOfFlight(0.003)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "noise must be one of"),
        ("laser", "noise must be one of"),
        ("structured-light:1", "noise must be one of"),
        ("stereo", "noise must be one of"),
        ("stereo:a", "baseline"),
        ("stereo:50", "millimetres"),
        ("stereo:0", "between 0"),
        ("stereo:nan", "between 0"),
        ("stereo:0.05,0", "above 0 pixels"),
        ("stereo:0.05,0.1,3", "noise must be one of"),
        ("time-of-flight:3", "millimetres"),
        ("time-of-flight:-1", "between 0"),
    ],
)
def test_what_is_none(text, words):
    refuses(InputError, words, noise_model, text)
