"""What rows of a constraint are assembled to, and what is refused."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from tests.conftest import small_scene
from tests.refusals import refuses
from ttus_opt.core.errors import InputError
from ttus_opt.problem.constraints.base import Bounds, ConeRows, Constraint, LinearRows

SCENE = small_scene(shape=(5, 8, 6), n_poses=5)
V = SCENE.n_voxels
ROWS = sp.csr_array(np.eye(6, V))


@dataclass(frozen=True)
class Own(Constraint):
    """Whatever is given."""

    given: Any = field(default=None, repr=False)
    name = "own"

    def rows(self):
        return self.given


def test_linear_rows_come_in_one_format_and_keep_their_meaning():
    given = LinearRows({"p": sp.coo_array(ROWS), "m": ROWS[:, :1]}, [0] * 6, [1] * 6)
    found = Own(SCENE, given).assembled
    assert isinstance(found, LinearRows)
    assert all(isinstance(M, sp.csr_array) for M in found.blocks.values())
    np.testing.assert_array_equal(found.blocks["p"].toarray(), np.eye(6, V))
    assert found.lower.dtype == found.upper.dtype == np.float64
    np.testing.assert_array_equal(found.upper, np.ones(6))


def test_rows_are_made_once():
    made = []

    @dataclass(frozen=True)
    class Counted(Constraint):
        name = "counted"

        def rows(self):
            made.append(1)
            return Bounds("p", np.zeros(V), np.full(V, np.inf))

    one = Counted(SCENE)
    assert one.assembled is one.assembled and made == [1]


def test_cones_take_all_rows():
    whole = Own(SCENE, ConeRows({"p": ROWS}, np.zeros(6), (4, 2))).assembled
    assert isinstance(whole, ConeRows) and whole.sizes == (4, 2)
    for sizes in ((4, 1), (4, 3), (6, 0), (7, -1)):
        own = Own(SCENE, ConeRows({"p": ROWS}, np.zeros(6), sizes))
        refuses(InputError, "one cone after the other", getattr, own, "assembled")


@pytest.mark.parametrize(
    ("lower", "upper", "told"),
    [
        (np.inf, np.inf, "6 lower limits are infinite on the wrong side"),
        (-np.inf, -np.inf, "6 upper limits are infinite on the wrong side"),
    ],
)
@pytest.mark.parametrize("kind", ["rows", "bounds"])
def test_limits_that_nothing_obeys_are_refused(kind, lower, upper, told):
    low, high = np.full(6, lower), np.full(6, upper)
    given = LinearRows({"p": ROWS}, low, high) if kind == "rows" else None
    limits = Own(SCENE, given or Bounds("m", low, high))
    refuses(InputError, told, lambda: limits.assembled)


def test_limits_of_different_lengths_are_refused():
    rows = Own(SCENE, LinearRows({"p": ROWS}, np.zeros(6), np.ones(5)))
    refuses(InputError, "6 lower limits and 5 upper ones", lambda: rows.assembled)
