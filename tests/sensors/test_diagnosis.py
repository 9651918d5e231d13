"""Figures of a stream against what it was made with."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ttus_opt.probe.raw_recording import RawRecording
from ttus_opt.sensors.diagnosis import diagnosis


def recording(n=2000):
    """Slow motion at 100 Hz with noise of 0.2 mm, 0.1 N and 3 mN m."""
    rng = np.random.default_rng(0)
    time = 0.01 * np.arange(n)
    position = 0.05 * np.sin(np.outer(time, [0.3, 0.5, 0.2]))
    turn = Rotation.from_rotvec(np.outer(np.sin(time), [0.3, 0, 0]))
    force = 5.0 * np.sin(np.outer(time, [0.1, 0.2, 0.3]))
    return RawRecording(
        "x",
        time,
        position + rng.normal(0, 2e-4, position.shape),
        turn.as_quat(scalar_first=True),
        force + rng.normal(0, 0.1, force.shape),
        0.02 * force + rng.normal(0, 3e-3, force.shape),
    )


def test_rate_span_noise_and_ranges():
    found = diagnosis(recording())
    assert found.holds == "poses and wrenches"
    assert found.rate == pytest.approx(100.0)
    assert found.seconds == pytest.approx(19.99)
    assert found.noise["position"] == pytest.approx(2e-4, rel=0.05)
    assert found.noise["force"] == pytest.approx(0.1, rel=0.05)
    assert found.noise["torque"] == pytest.approx(3e-3, rel=0.05)
    assert found.turned == pytest.approx(0.3, abs=1e-3)
    np.testing.assert_allclose(found.position[1], 0.05, atol=2e-3)
    assert not found.faults and not found.units and not found.repair
    assert found.lines()[-1] == "no faults"


def test_holes_are_counted():
    raw = recording()
    raw.position[700:710] += 0.4  # out and back
    raw.force[5] = np.nan
    time = raw.time.copy()
    time[1000:] += 2.0
    time[1500] = time[1499]
    found = diagnosis(raw.replaced(time=time))
    assert found.gaps == (1, pytest.approx(2.01))
    assert (found.missing, found.repeated, found.late, found.jumps) == (1, 1, 0, 2)
    assert any("frame 5: fx is nan" in fault for fault in found.faults)
    assert any("split at jumps" in word for word in found.repair)
    facts = found.facts()
    assert facts["longest_gap_s"] == pytest.approx(2.01)


@pytest.mark.parametrize(
    ("name", "factor", "words"),
    [
        ("time", 1e3, "rows are 10 s apart, so t is likely in ms"),
        ("position", 1e3, "likely in mm: px=NAME"),
        ("position", 300.0, "likely in cm (or mm): px=NAME[cm]"),
        ("force", 1e6, "counts or mN"),
        ("torque", 1e3, "a lever of 20 m in the median, so torques are likely in N mm"),
    ],
)
def test_units_are_doubted_with_the_reason(name, factor, words):
    raw = recording()
    bad = raw.replaced(**{name: factor * getattr(raw, name)})
    (doubt,) = diagnosis(bad).units
    assert words in doubt
    assert not diagnosis(bad.replaced(units_stated=True)).units


def test_numbers_beyond_any_unit():
    """Damaged ones overflow in arithmetic, which is nobody's warning."""
    raw = recording()
    raw.position[7:9] = 1e300
    raw.force[9:] = 1e300
    told = diagnosis(raw)
    assert told.force == pytest.approx(3.0**0.5 * 1e300)
    assert "1.732e+300 N in the median" in told.units[0]
    assert (
        "x -0.050 to 1e+300" in told.lines()[1] and "1e+300 m is not" in told.faults[0]
    )


def test_a_stream_that_was_never_valid():
    """PLUS writes such a transform for a tool that was not in view."""
    whole = recording(50).noted("mm")
    found = diagnosis(whole.without(np.ones(50, bool), "not OK"))
    assert found.faults == ("no frame is valid: was the target in view?",)
    assert found.rows == 0 and found.segments == 0
    assert found.lines()[0] == "poses and wrenches, 0 rows over 0 s"
    assert "50 of 50 frames are not OK: gaps" in found.lines()
    alone = RawRecording("x", np.zeros(0), np.zeros((0, 3)), np.zeros((0, 4)))
    assert alone.rows().shape == (0, 8)
