"""The parabola through fits, of objectives that are given."""

from types import SimpleNamespace

import numpy as np
import pytest

from ttus_opt.fitting.parameters.identification import NO_SLOPE
from ttus_opt.fitting.parameters.parabola import ROUNDING, Parabola
from ttus_opt.problem.solution import Status

CENTRE, STEP = np.array([0.3, -2.0]), np.array([0.1, 0.4])
BENT = np.array([[6.0, 1.0], [1.0, 2.0]])
LEAST = np.array([0.35, -1.5])


def bowl(v):
    return 10.0 + 0.5 * float((v - LEAST) @ BENT @ (v - LEAST))


def fits(objective, gap=0.0):
    """Solved fits with an objective and a gap."""

    def fitted(v):
        kkt = SimpleNamespace(gap=gap)
        return SimpleNamespace(status=Status.SOLVED, kkt=kkt, objective=objective(v))

    return fitted


def test_a_parabola_is_found_exactly():
    found = Parabola.through(fits(bowl), CENTRE, STEP)
    np.testing.assert_allclose(found.curvature, BENT, rtol=1e-9)
    np.testing.assert_allclose(found.gradient, BENT @ (CENTRE - LEAST), rtol=1e-9)
    np.testing.assert_allclose(found.vertex, LEAST, rtol=1e-9)
    assert found.solution.objective == bowl(CENTRE)
    assert not found.flat.any()


def test_errors_are_those_of_weighted_least_squares():
    """J = ‖A v − t‖² has curvature 2 AᵀA and covariance σ² (AᵀA)⁻¹."""
    A = np.random.default_rng(0).normal(size=(9, 2))
    found = Parabola.through(fits(lambda v: float(np.sum((A @ v) ** 2))), CENTRE, STEP)
    expected = np.sqrt(0.04 * np.diagonal(np.linalg.inv(A.T @ A)))
    np.testing.assert_allclose(found.errors(0.04), expected, rtol=1e-8)


def test_noise_is_what_gaps_and_rounding_make():
    found = Parabola.through(fits(bowl, gap=1e-3), CENTRE, STEP)
    largest = max(bowl(CENTRE + s * STEP) for s in ([-1, 0], [0, -1], [1, 1]))
    expected = 4.0 * (1e-3 + ROUNDING * largest) / STEP**2
    np.testing.assert_allclose(found.noise, expected, rtol=1e-9)


@pytest.mark.parametrize("at", [0, 1])
def test_a_curvature_within_the_noise_is_flat(at):
    """Just above and just below twice the noise, the other far above."""
    gap = 1e-4
    for factor, is_flat in ((1.9, True), (2.1, False)):
        bent = np.array([50.0, 50.0])
        bent[at] = factor * 4.0 * gap / STEP[at] ** 2
        found = Parabola.through(
            fits(lambda v, bent=bent: 0.5 * float(bent @ (v - CENTRE) ** 2), gap),
            CENTRE,
            STEP,
        )
        assert found.flat[at] == is_flat
        assert not found.flat[1 - at]
        if is_flat:
            assert found.reason == NO_SLOPE


@pytest.mark.parametrize("scale", [1e-3, 1.0])
def test_a_saddle_has_no_least_value(scale):
    """Also one that no parameter alone shows."""
    found = Parabola.through(fits(lambda v: -scale * bowl(v)), CENTRE, STEP)
    assert found.flat.all()
    assert "no least value" in found.reason
    turned = scale * np.array([[1.0, 3.0], [3.0, 1.0]])
    saddle = fits(lambda v: 0.5 * float((v - LEAST) @ turned @ (v - LEAST)))
    assert Parabola.through(saddle, CENTRE, STEP).flat.all()


@pytest.mark.parametrize("place", [(0, 0), (1, 0), (-1, 0), (0, -1), (1, 1)])
def test_a_fit_that_is_not_solved_is_not_used(place):
    """Its objective would fit the parabola best of all."""
    solved = fits(bowl)

    def fitted(v):
        found = solved(v)
        if np.allclose(v, CENTRE + np.array(place) * STEP):
            found.status = Status.INACCURATE
        return found

    assert Parabola.through(fitted, CENTRE, STEP) is None
