"""Measured forces with drag: the drag model's rows, and its parameters handed on."""

import numpy as np

from tests.problem.terms.test_drag import (
    DEADBAND,
    MU,
    by_coulomb,
    contact,
    field,
    scene,
)
from ttus_opt.problem.terms.drag import CoulombField, GlobalCoulomb
from ttus_opt.problem.terms.drag_force import DragForceTerm


def test_its_residual_is_contact_and_drag_less_what_was_measured():
    model = GlobalCoulomb(scene(), "contact", DEADBAND, MU)
    rows = DragForceTerm(scene(), 2.0, drag=model).assembled
    found = rows.blocks["p"] @ field() - rows.target
    expected = contact()[0] + by_coulomb(model, MU) - scene().f.reshape(-1, 3)
    np.testing.assert_allclose(found.reshape(-1, 3), expected, atol=1e-12)


def test_what_its_drag_knows_is_its_own():
    model = CoulombField(scene(), deadband=DEADBAND)
    term, values = DragForceTerm(scene(), drag=model), {"p": field(), "q": MU * field()}
    assert term.parameters(values) == model.parameters(values)
    assert term.fitted(values).keys() == model.fitted(values).keys()
    assert term.not_identifiable() == model.not_identifiable()


def test_without_drag_its_rows_are_those_of_the_force():
    model = CoulombField(scene(), deadband=DEADBAND)
    term = DragForceTerm(scene(), 2.0, drag=model)
    neutral = term.with_neutral(["friction_coefficient"])
    assert set(neutral.assembled.blocks) == {"p"} and neutral.weight == 2.0
    assert abs(neutral.assembled.blocks["p"] - scene().N).max() < 1e-12
    assert term.with_neutral(["another"]) is term
