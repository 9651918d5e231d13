"""The comparator of the documentation works as it stands there."""

import math
import re
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from tests.comparators.recordings import fitted, recordings
from tests.kit import InputError, ellipsoid, torso
from ttus_opt.comparators import available, compare, comparison, markdown
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.report.metrics import angles


class Known:
    """Renders what it is told to, along z."""

    name = "known"

    def __init__(self, force):
        self.force = force

    def wrenches(self, trajectory):
        out = np.zeros((len(trajectory), 6))
        out[:, 2] = np.resize(self.force, len(trajectory))
        return out


@pytest.mark.slow
def test_a_table_has_a_row_per_comparator_and_recording():
    press, slide = (part.select(slice(0, 40)) for part in recordings())
    began: list[str] = []
    rows = compare(
        ["signed_distance", "ellipsoid_torso"],
        torso(),
        ellipsoid(),
        press,
        {"a": press, "b": slide},
        progress=began.append,
    )
    assert began == ["signed_distance", "ellipsoid_torso"]
    assert [(r.comparator, r.recording) for r in rows] == [
        (name, label) for name in began for label in "ab"
    ]
    for row in rows:
        figures = [v for v in row.as_dict().values() if isinstance(v, float)]
        assert np.isfinite(figures).all()
        assert row.ms_per_frame > 0.0
    table = markdown(rows).splitlines()
    assert [cell.strip() for cell in table[0].split("|")[1:3]] == ["a / b", "force [N]"]
    order = [line.split("`")[1] for line in table[2:]]
    assert sorted(order) == sorted(began)
    assert {line.count("|") for line in table} == {8}
    both = (
        f"{rows[0].force_magnitude_error_N:.2f} / {rows[1].force_magnitude_error_N:.2f}"
    )
    assert both in table[2 + order.index(began[0])]
    mean = {
        name: sum(r.force_magnitude_error_N for r in rows if r.comparator == name)
        for name in began
    }
    assert mean[order[0]] <= mean[order[1]]
    fast = min(rows, key=lambda row: row.ms_per_frame)
    assert f"frame / {fast.comparator}" in table[0]
    assert f"frame / {rows[0].comparator}" in markdown(rows, rows[0].comparator)


def test_errors_are_those_of_the_rendered_wrenches():
    _, slide = recordings()
    row = comparison.judged(fitted("signed_distance"), "slide", slide)
    wrench = fitted("signed_distance").wrenches(slide)
    size = np.linalg.norm(slide.force, axis=1)
    off = np.linalg.norm(wrench[:, :3], axis=1) - size
    assert row.force_magnitude_error_N == pytest.approx(np.abs(off).mean())
    turned = angles(slide.force, wrench[:, :3])[size > 0.5]
    assert row.force_angle_error_deg == pytest.approx(turned.mean())


def test_one_that_cannot_be_fitted_says_why_in_its_rows():
    press, _ = recordings()
    bare = Trajectory(press.time, press.position, press.rotation)
    (row,) = compare(["signed_distance"], torso(), ellipsoid(), bare, {"a": press})
    assert "columns fx, fy, fz" in row.failure
    assert math.isnan(row.force_magnitude_error_N)
    assert row.failure in markdown([row])


class Busy(Known):
    """Its first call takes long, as if compiling, and so does the recording's motion.

    Later calls keep another thread busy, and this one for a while.
    """

    def __init__(self):
        super().__init__(np.ones(1))
        self.calls = 0

    def wrenches(self, trajectory):
        self.calls += 1
        if self.calls == 1 or "_twist" not in vars(trajectory):
            burn(0.2)
        else:
            other = threading.Thread(target=burn, args=(0.2,))
            other.start()
            other.join()
            burn(0.02)
        return super().wrenches(trajectory)


def burn(seconds):
    """Keep this thread's processor busy."""
    end = time.thread_time() + seconds
    while time.thread_time() < end:
        pass


def test_a_frame_is_timed_without_first_call_and_other_threads():
    press = recordings()[0].select(slice(0, 40))
    wrench, frame = comparison.timed_wrenches(Busy(), press)
    assert wrench.shape == (len(press), 6)
    assert 0.02 <= frame * len(press) < 0.12


def test_ripple_is_what_short_waves_are_and_long_ones_are_not():
    press, _ = recordings()
    share = np.linspace(0.0, 1.0, 301)
    for waves, expected in ((1.0, 0.0), (30.0, 0.05 / math.sqrt(2.0))):
        force = 1.0 + 0.05 * np.sin(2.0 * np.pi * waves * share)
        assert comparison.ripple(Known(force), press) == pytest.approx(
            expected, abs=2e-3
        )


def test_the_slide_goes_through_the_firmest_pose_along_z():
    press, _ = recordings()
    firm = np.linalg.norm(press.force, axis=1).argmax()
    slide = comparison.slow_slide(press)
    np.testing.assert_allclose(slide.position.mean(axis=0), press.position[firm])
    np.testing.assert_allclose(
        np.ptp(slide.position, axis=0), [0.0, 0.0, comparison.SLIDE]
    )


def test_nothing_to_judge_by_is_told():
    press, _ = recordings()
    with pytest.raises(InputError, match="at least one unseen recording"):
        compare(None, torso(), ellipsoid(), press, {})
    with pytest.raises(InputError, match="unknown comparator"):
        compare(["laplase"], torso(), ellipsoid(), press, {"a": press})


PAGE = Path(__file__).resolve().parents[2] / "docs" / "comparators.md"


def test_the_shown_comparator_renders_one_spring():
    code = re.findall(r'```python title=".*?"\n(.*?)```', PAGE.read_text(), re.S)
    names: dict[str, object] = {"__name__": "own"}
    exec(compile(code[0], "comparators.md", "exec"), names)
    kind = names["DeepestPoint"]
    assert callable(kind)
    own = kind(surface=torso(), shell=ellipsoid()).fit(recordings())
    row = comparison.judged(own, "slide", recordings()[1])
    other = comparison.judged(fitted("signed_distance"), "slide", recordings()[1])
    # both are straight springs along the same direction
    assert abs(row.force_angle_error_deg - other.force_angle_error_deg) < 2.0
    assert np.isfinite(row.ripple)


def test_the_page_has_every_comparator():
    page = PAGE.read_text()
    assert [name for name in available() if f"`{name}`" not in page] == []
