"""Certificates, and the constraints that they name."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy.sparse as sp

from tests.kit import small_scene
from tests.solvers.problems import bounds, program, rows, term
from ttus_opt.problem.constraints.base import Bounds, Constraint
from ttus_opt.problem.constraints.boundary import HardBoundary
from ttus_opt.problem.constraints.monotone import Monotone
from ttus_opt.problem.constraints.signs import Sign
from ttus_opt.problem.members import ProgramCones
from ttus_opt.problem.program import Program
from ttus_opt.problem.terms.laplace import LaplaceTerm
from ttus_opt.problem.terms.penalties import Linear
from ttus_opt.problem.verify.certificate import (
    conflicting,
    contradicts,
    decreases_forever,
    falling_ray,
)
from ttus_opt.problem.verify.kkt import Duals

INF = np.inf

#: x + y ≥ 3 within [-1, 1]²
IMPOSSIBLE = program(
    [term(np.eye(2), [0, 0])],
    [rows("high", [[1, 1]], [3], [INF])],
    [bounds("low", [-1, -1], [1, 1])],
)
POSSIBLE = program(
    [term(np.eye(2), [0, 0])],
    [rows("high", [[1, 1]], [1.5], [INF])],
    [bounds("low", [-1, -1], [1, 1])],
)

#: x² + y over y ≤ 3
DOWNHILL = program(
    [term([[1, 0]], [0]), term([[0, 1]], [0], 1.0, Linear(), name="downhill")],
    (),
    [bounds("half", [-1, -INF], [1, 3])],
)


def duals(y, z):
    return Duals({"high": np.array([y])}, np.array(z))


def test_multipliers_that_add_up_to_less_than_nothing_prove_it():
    """-1·(x + y) + 1·x + 1·y = 0, while the limits add up to -3 + 1 + 1."""
    proof = duals(-1.0, [1.0, 1.0])
    assert contradicts(IMPOSSIBLE, proof)
    assert not contradicts(POSSIBLE, proof)  # -1.5 + 2 > 0
    assert contradicts(IMPOSSIBLE, duals(-1.0, [1.0, 0.9]))  # -0.1 y ≥ -0.1 is left


@pytest.mark.parametrize(
    "wrong",
    [
        duals(-1.0, [1.0, -2.0]),  # does not cancel
        duals(1.0, [-1.0, -1.0]),  # pulls at a limit that is not there
        duals(0.0, [0.0, 0.0]),
        Duals(),
    ],
)
def test_what_proves_nothing(wrong):
    assert not contradicts(IMPOSSIBLE, wrong)


def test_a_ray_along_which_it_falls():
    assert decreases_forever(DOWNHILL, np.array([0.0, -1.0]))
    assert decreases_forever(DOWNHILL, np.array([0.0, -1e9]))
    for no in ([0.0, 1.0], [1.0, -1.0], [0.0, 0.0], [0.0, np.nan]):
        assert not decreases_forever(DOWNHILL, np.array(no))
    ray = falling_ray(DOWNHILL)
    assert ray[1] < 0.0 == ray[0]


def test_a_minimum_has_no_ray():
    held = program(DOWNHILL.terms, (), [bounds("box", [-1, -5], [1, 3])])
    assert falling_ray(held) is None
    assert not decreases_forever(held, np.array([0.0, -1.0]))
    assert falling_ray(IMPOSSIBLE) is None
    weightless = program([term([[1, 0]], [0]), term([[0, 1]], [0], 0.0, Linear(),
                         name="downhill")])  # fmt: skip
    assert falling_ray(weightless) is None


@pytest.mark.parametrize("tiny", [1e-6, 1e-10, 1e-14])
def test_what_holds_far_away_is_not_contradicted(tiny):
    """x₀ + ε x₁ ≤ 0 and x₀ ≥ 1 hold at x₁ = −1/ε, unless x₁ has a limit above that."""
    y, z = np.array([1.0]), np.array([-1.0, 0.0])
    low = rows("low", [[1.0, tiny]], [-INF], [0.0])
    for least, proven in ((-INF, False), (-2.0 / tiny, False), (-0.5 / tiny, True)):
        box = bounds("box", [1.0, least], [INF, INF])
        one = program([term(np.eye(2), [0, 0])], [low], [box])
        assert contradicts(one, Duals({"low": y}, z)) == proven
        assert proven or not conflicting(one)


@pytest.mark.parametrize("tiny", [1e-6, 1e-13])
def test_sums_that_nearly_cancel_contradict_nothing(tiny):
    """x₀ + x₁ ≤ 0 and x₀ + (1 − ε) x₁ ≥ 1 hold together at −x₁ = x₀ = 1/ε."""
    both = rows("both", [[1.0, 1.0], [1.0, 1.0 - tiny]], [-INF, 1.0], [0.0, INF])
    far = program([term(np.eye(2), [0, 0])], [both])
    assert not contradicts(far, Duals({"both": np.array([1.0, -1.0])}))
    exact = rows("both", [[1.0, 1.0], [1.0, 1.0]], [-INF, 1.0], [0.0, INF])
    never = program([term(np.eye(2), [0, 0])], [exact])
    assert contradicts(never, Duals({"both": np.array([1.0, -1.0])}))


@pytest.mark.parametrize("tiny", [1e-6, 1e-10, 1e-14])
def test_what_grows_far_away_has_a_minimum(tiny):
    """x₀² + (ε x₁)² + x₁ is least at x₁ = −1/(2 ε²)."""
    bounded = program(
        [
            term([[1.0, 0.0], [0.0, tiny]], [0.0, 0.0]),
            term([[0.0, 1.0]], [0.0], 1.0, Linear(), name="downhill"),
        ]
    )
    assert not decreases_forever(bounded, np.array([0.0, -1.0]))
    assert falling_ray(bounded) is None
    assert decreases_forever(DOWNHILL, np.array([0.0, -1.0]))


def test_a_ray_within_limits_but_for_its_rounding():
    """x ≥ 0 falls along y; a row that the ray leaves in earnest, however small."""
    down = term([[0.0, 1.0]], [0.0], 1.0, Linear(), name="downhill")
    free = program([down], (), [bounds("half", [0.0, -INF], [INF, 3.0])])
    assert decreases_forever(free, np.array([-1e-12, -1.0]))
    assert not decreases_forever(free, np.array([-1e-6, -1.0]))
    tied = rows("tied", [[1.0, 1e-10]], [-1.0], [INF])
    held = program([down], [tied], [bounds("half", [0.0, -INF], [INF, 3.0])])
    assert not decreases_forever(held, np.array([0.0, -1.0]))
    assert decreases_forever(held, np.array([1.0, -1.0]))


def test_upper_limits_hold_a_ray():
    """x² − y falls as y grows, until a bound or a row limits y from above."""
    terms = [term([[1, 0]], [0]), term([[0, -1]], [0], 1.0, Linear(), name="downhill")]
    up, box = np.array([0.0, 1.0]), bounds("half", [-1, -3], [1, INF])
    below = rows("below", [[0, 1]], [-3], [INF])
    free = program(terms, [below], [box])
    ray = falling_ray(free)
    assert decreases_forever(free, up)
    assert ray[1] > 0.0 == ray[0]
    above = rows("above", [[0, 1]], [-INF], [3])
    bound = bounds("box", [-1, -INF], [1, 3])
    for held in (program(terms, [above], [box]), program(terms, (), [bound])):
        assert not decreases_forever(held, up)
        assert falling_ray(held) is None


@pytest.mark.parametrize("tiny", [1e-6, 1e-10])
def test_an_upper_limit_of_what_does_not_cancel(tiny):
    """x₀ − ε x₁ ≤ 0 and x₀ ≥ 1 hold at x₁ = 1/ε, unless x₁ stays below that."""
    low = rows("low", [[1.0, -tiny]], [-INF], [0.0])
    given = Duals({"low": np.array([1.0])}, np.array([-1.0, 0.0]))
    for most, proven in ((INF, False), (2.0 / tiny, False), (0.5 / tiny, True)):
        box = bounds("box", [1.0, -INF], [INF, most])
        one = program([term(np.eye(2), [0, 0])], [low], [box])
        assert contradicts(one, given) == proven


@pytest.mark.parametrize("limit", ["row", "bound"])
def test_a_ray_is_sought_within_upper_limits(limit):
    """−x − y falls along y alone where x has an upper limit."""
    down = term([[-1, -1]], [0], 1.0, Linear(), name="downhill")
    high = rows("high", [[1, 0]], [-INF], [3]), bounds("box", [-1, -1], [3, INF])
    held = [high[0]] if limit == "row" else []
    box = [] if limit == "row" else [high[1]]
    ray = falling_ray(program([down], held, box))
    assert ray[1] > 0.0


def test_limits_that_meet_contradict_nothing():
    """x ≤ 1 and x ≥ 1: the limits add up to exactly zero."""
    meet = rows("meet", [[1.0, 0.0], [1.0, 0.0]], [-INF, 1.0], [1.0, INF])
    one = program([term(np.eye(2), [0, 0])], [meet])
    assert not contradicts(one, Duals({"meet": np.array([1.0, -1.0])}))


def test_a_ray_stays_within_cones():
    """y falls within y ≤ −|x|, but not within y ≥ |x|."""
    down = term([[0.0, 1.0]], [0.0], 1.0, Linear(), name="down")
    for sign in (1.0, -1.0):
        matrix = sp.csr_array(np.array([[0.0, sign], [1.0, 0.0]]))
        cone = ProgramCones("cone", matrix, np.zeros(2), (2,))
        one = replace(program([down]), cones=(cone,))
        assert decreases_forever(one, np.array([0.0, -1.0])) == (sign < 0.0)


SCENE = small_scene("trilinear", shape=(7, 12, 8), n_poses=4)


@dataclass(frozen=True)
class Band(Constraint):
    """Bounds on every voxel."""

    low: float = -np.inf
    high: float = np.inf

    name = "band"
    formula = "low ≤ p ≤ high"

    def rows(self):
        V = self.scene.n_voxels
        return Bounds("p", np.full(V, self.low), np.full(V, self.high))


HARD, SIGN = HardBoundary(SCENE), Sign(SCENE)
#: 2 N at the inner layer cannot fall so fast over 6 cm
STEEP = Monotone(SCENE, 1000.0)


@pytest.mark.parametrize(
    ("limits", "named"),
    [
        ([], ()),
        ([SIGN], ()),
        ([SIGN, Monotone(SCENE), HARD], ()),
        *(([Monotone(SCENE, slope), HARD], ()) for slope in (10.0, 20.0)),
        ([SIGN, STEEP], ()),  # soft boundary values give way
        ([SIGN, STEEP, HARD], ("monotone", "boundary")),
        ([STEEP, Band(SCENE, 0.0, 5.0)], ("monotone", "band")),
        ([SIGN, Band(SCENE, low=1.0)], ("sign", "band")),
    ],
)
def test_constraints_that_contradict_are_named_and_no_others(limits, named):
    assert conflicting(Program.build(SCENE, [LaplaceTerm(SCENE)], limits)) == named
