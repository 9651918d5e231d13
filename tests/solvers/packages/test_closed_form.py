"""The closed form: one factor for equal matrices, and what a package may add."""

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from tests.kit import small_scene
from ttus_opt.problem import formulation
from ttus_opt.solvers.base import Claim, Request
from ttus_opt.solvers.packages.closed_form import ClosedForm, Factor

SCENE = small_scene("trilinear", shape=(5, 8, 5), n_poses=4)


def compiled(weight=1.0, name="eq10"):
    weights = {"force_weight": weight, "torque_weight": weight}
    return formulation.load(name, SCENE, **weights).compile()


class Counting(ClosedForm):
    """Writes down what it is asked for."""

    name, summary = "counting", ""

    def __init__(self, keeps_analysis):
        self.keeps, self.done = keeps_analysis, list[str]()

    def factorise(self, Q):
        self.done.append("factorise")
        held = {"lu": splu(sp.csc_array(Q))}

        def again(other):
            self.done.append("refactorise")
            held["lu"] = splu(sp.csc_array(other))

        change = again if self.keeps else None
        return Factor(
            lambda d: held["lu"].solve(d), change, lambda: self.done.append("release")
        )


@pytest.mark.parametrize("keeps", [True, False])
def test_a_factor_is_kept_changed_or_released(keeps):
    solver = Counting(keeps)
    prepared = solver.prepare(compiled(), Request(1e-6))
    prepared.update(compiled())  # equal numbers
    assert solver.done == ["factorise"]
    prepared.update(compiled(2.0))  # the same pattern
    more = ["refactorise"] if keeps else ["release", "factorise"]
    assert solver.done == ["factorise", *more]
    prepared.update(compiled(2.0, "tikhonov"))  # another pattern or numbers
    x = prepared.solve().x
    Q, d = compiled(2.0, "tikhonov").normal_equations()
    np.testing.assert_allclose(x, np.linalg.solve(Q.toarray(), d), rtol=1e-7, atol=1e-9)


def test_what_cannot_be_factorised_is_said():
    nothing = formulation.load("eq10", SCENE).with_weights(laplace=0.0).compile()
    found = ClosedForm().prepare(nothing, Request(1e-6)).solve()
    assert found.x is None and found.claim is Claim.GAVE_UP
    assert "Q" in found.detail
