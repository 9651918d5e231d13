"""Presses left out of a depth map, against fits without them; what follows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.fitting.test_tuning import drawn, tuned
from ttus_opt.fitting.left_out import Check, LeftOut
from ttus_opt.fitting.weight_criteria import presses

PRESS = np.array([0, 0, 0, 1, 1, 2, 3, 3, 3])


def model(name: str, frames: list[int], errors: list[float]) -> LeftOut:
    return LeftOut(name, np.array(frames), np.array(errors))


def test_every_press_is_one_witness() -> None:
    rich = model("rich", [0, 1, 2, 3, 5, 8], [1.0, 2.0, 3.0, 5.0, 1.0, 9.0])
    plain = model("plain", [0, 1, 2, 3, 5, 6], [2.0, 2.0, 2.0, 6.0, 3.0, 0.0])
    check = Check.between(rich, plain, PRESS)
    assert check.presses == 3 and check.made and check.holds and check.better
    assert rich.mean_over(PRESS[rich.frames]) == pytest.approx((2 + 5 + 1 + 9) / 4)
    assert check.richer_error == pytest.approx((2.0 + 5.0 + 1.0) / 3.0)
    assert check.simpler_error == pytest.approx((2.0 + 6.0 + 3.0) / 3.0)
    # differences 0, -1, -2: deviation 1, over the root of three
    assert check.difference_error == pytest.approx(1.0 / np.sqrt(3.0))
    assert "rich predicts presses left out better than plain" in str(check)
    swapped = Check.between(plain, rich, PRESS)
    assert not swapped.holds and "worse than rich" in str(swapped)
    same = Check.between(rich, replace(rich, model="plain"), PRESS)
    assert same.holds and not same.better and "about as well as plain" in str(same)
    assert swapped.as_dict()["holds"] is False
    # worse by 1/3 N, which three presses scatter more than
    other = Check.between(rich, model("other", [0, 3, 5], [3.0, 1.0, 1.0]), PRESS)
    assert other.richer_error > other.simpler_error and other.holds
    assert other.difference_error > other.richer_error - other.simpler_error


def test_two_presses_bear_no_check() -> None:
    rich = model("rich", [0, 3], [9.0, 9.0])
    check = Check.between(rich, model("plain", [0, 3], [1.0, 1.0]), PRESS)
    assert check.holds and not check.made
    assert "could not be checked by presses left out: 2 of them" in str(check)


def test_a_tuning_tells_the_errors_of_its_presses() -> None:
    found, scene = tuned(), drawn()
    touching = np.flatnonzero(scene.rows.contact_points > 0)
    np.testing.assert_array_equal(found.left_out.frames, touching)
    # vectors differ by no less than their lengths, of which `tune` tells the mean
    assert found.left_out.errors.mean() > found.left_out_force_error
    check = Check.between(found.left_out, found.own_left_out, presses(scene))
    assert check.holds and check.simpler_error > 1.2 * check.richer_error
