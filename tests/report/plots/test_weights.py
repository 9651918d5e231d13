"""The picture of a path draws its numbers."""

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError, presses, refuses, small_scene, torso

WEIGHTS = [1e-3, 1e-1, 10.0]


def path(**more):
    scene = small_scene("trilinear")
    return tt.solution_path("eq10", scene, **more)


def test_the_curve_and_the_errors_are_those_of_the_path():
    unseen = presses(torso(), 6, np.random.default_rng(9))
    found = path(weights={"force": WEIGHTS}, held_out={"unseen": unseen})
    left, right, angle = tt.plots.weight_path(found, title="a path").axes
    value = found["term_value"]
    x, y = left.lines[0].get_data()
    np.testing.assert_allclose(x, value.sel(term="force"))
    rest = value.sel(term="laplace") + 1e-2 * value.sel(term="torque")
    np.testing.assert_allclose(y, rest, rtol=1e-6)
    assert left.get_title(loc="left") == "a path, with some of its weights"
    # torque is weighed by the formulation and stands with the others
    assert left.get_xlabel() == "force, without weight [N²]"
    assert left.get_ylabel() == "all other terms [(N/cm²)²]"
    named = [text.get_text() for text in right.get_legend().get_texts()]
    assert named == ["unseen, force", "least", "unseen, angle"]
    error = found["held_out_force_magnitude_error"].to_numpy()[:, 0]
    np.testing.assert_allclose(right.lines[0].get_data()[1], error)
    assert right.lines[1].get_xdata()[0] == WEIGHTS[error.argmin()]
    held_angle = found["held_out_force_angle_error"].to_numpy()[:, 0]
    np.testing.assert_allclose(angle.lines[0].get_data()[1], held_angle)


def test_without_held_out_recordings_the_residuals_are_drawn():
    found = path(weights={"force": WEIGHTS})
    right = tt.plots.weight_path(found).axes[1]
    np.testing.assert_allclose(
        right.lines[0].get_data()[1], found["force_residual"].to_numpy()[:, 0]
    )


def test_a_grid_is_a_map():
    found = path(weights={"force": WEIGHTS, "torque": [1e-2, 1.0]})
    left, right, _bar = tt.plots.weight_path(found).axes
    told = left.get_legend()
    assert told.get_title().get_text() == "torque weight"
    assert [line.get_text() for line in told.get_texts()] == ["0.01", "1"]
    drawn = np.asarray(right.collections[0].get_array()).reshape(2, 3)
    np.testing.assert_allclose(drawn, found["force_residual"].mean("recording").T)


def test_what_cannot_be_drawn_is_one_line():
    found = path(weights={"force": [1.0]})
    with pytest.raises(InputError, match="solution_path"):
        tt.plots.weight_path(found.drop_vars("term_value"))
    with pytest.raises(InputError, match="no point"):
        tt.plots.weight_path(found.assign(objective=found["objective"] * np.nan))
    three = found.expand_dims({"a_weight": 1, "b_weight": 1})
    refuses(InputError, "3 weights", tt.plots.weight_path, three)
