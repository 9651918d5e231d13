"""Presses left out of a depth map, against fits without them; what follows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.fitting.test_tuning import drawn, tuned
from ttus_opt.errors import InputError
from ttus_opt.fitting import left_out, tuning
from ttus_opt.fitting.left_out import Check, LeftOut, left_out_of
from ttus_opt.fitting.tuning_series import TuningRows
from ttus_opt.fitting.weight_criteria import presses
from ttus_opt.problem.formulation import Formulation
from ttus_opt.scene import Scene
from ttus_opt.terms.depth_map import DepthMapTerm
from ttus_opt.terms.force import ForceTerm


def error_without(
    scene: Scene, number: int, declared: Formulation, every: int
) -> np.ndarray:
    """‖f - f̂‖ on a press left out of a fit to every so many frames."""
    press = presses(scene)
    looked_at = np.zeros(len(press), dtype=bool)
    looked_at[np.flatnonzero(scene.rows.contact_points > 0)[::every]] = True
    own, out = looked_at & (press != number), looked_at & (press == number)
    kept = replace(
        scene,
        trajectory=scene.trajectory.select(own),
        rows=replace(scene.rows, N=scene.N[np.repeat(own, 3)]),
    )
    prior, force, _ = declared.terms
    assert isinstance(prior, DepthMapTerm)
    terms = [replace(prior, scene=kept), ForceTerm(kept, every * force.weight)]
    solution = tt.fit(kept, Formulation(terms=terms))
    off = (scene.f - scene.N @ solution.candidate).reshape(-1, 3)[out]
    return np.linalg.norm(off, axis=1)


@pytest.mark.parametrize(("most", "every"), [(200, 1), (6, 2)])
def test_presses_left_out_of_a_depth_map_are_fits_without_them(
    most: int, every: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(left_out, "MOST_FRAMES", most)
    scene = drawn()
    declared = tt.load_formulation("depth_map", scene)
    found = left_out_of(declared)
    frames = np.flatnonzero(scene.rows.contact_points > 0)[::every]
    np.testing.assert_array_equal(found.frames, frames)
    expected = [
        error_without(scene, number, declared, every)
        for number in np.unique(presses(scene)[frames])
    ]
    assert len(expected) == 3
    np.testing.assert_allclose(found.errors, np.concatenate(expected), rtol=1e-4)


def test_only_priors_of_known_covariance_with_forces() -> None:
    with pytest.raises(InputError, match="eq10 has no prior of known covariance"):
        left_out_of(tt.load_formulation("eq10", drawn()))


PRESS = np.array([0, 0, 0, 1, 1, 2, 3, 3, 3])


def model(name: str, frames: list[int], errors: list[float]) -> LeftOut:
    return LeftOut(name, np.array(frames), np.array(errors))


def test_every_press_is_one_witness() -> None:
    rich = model("rich", [0, 1, 2, 3, 5, 8], [1.0, 2.0, 3.0, 5.0, 1.0, 9.0])
    plain = model("plain", [0, 1, 2, 3, 5, 6], [2.0, 2.0, 2.0, 6.0, 3.0, 0.0])
    check = Check.between(rich, plain, PRESS)
    assert check.presses == 3 and check.made and check.holds and check.better
    assert check.clear and not replace(check, difference_error=1.5).clear
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
