"""Measured forces and torques with drag: the drag model's rows, its parameters."""

import numpy as np
import pytest

from tests.problem.terms.test_drag import (
    DEADBAND,
    MU,
    by_coulomb,
    contact,
    field,
    scene,
)
from ttus_opt.problem.terms.drag import CoulombField, GlobalCoulomb
from ttus_opt.problem.terms.wrench import DragForceTerm, DragTorqueTerm


def test_the_residual_is_contact_and_drag_less_what_was_measured():
    """Drag acts at the contact: its moment is arm × drag; torque is over a length."""
    model, length = GlobalCoulomb(scene(), "contact", DEADBAND, MU), 0.05
    (force, torque), drag = contact(), by_coulomb(model, MU)
    rows = DragForceTerm(scene(), 2.0, drag=model).assembled
    found = rows.blocks["p"] @ field() - rows.target
    expected = force + drag - scene().f.reshape(-1, 3)
    np.testing.assert_allclose(found.reshape(-1, 3), expected, atol=1e-12)
    rows = DragTorqueTerm(scene(), length=length, drag=model).assembled
    found = length * (rows.blocks["p"] @ field() - rows.target)
    expected = torque + np.cross(model.sliding.arm, drag) - scene().tau.reshape(-1, 3)
    np.testing.assert_allclose(found.reshape(-1, 3), expected, atol=1e-12)


def test_what_its_drag_knows_is_its_own():
    model = CoulombField(scene(), deadband=DEADBAND)
    term, values = DragForceTerm(scene(), drag=model), {"p": field(), "q": MU * field()}
    assert term.parameters(values) == model.parameters(values)
    assert term.fitted(values).keys() == model.fitted(values).keys()
    assert term.not_identifiable() == model.not_identifiable()


@pytest.mark.parametrize("kind", [DragForceTerm, DragTorqueTerm])
def test_without_drag_its_rows_are_those_of_the_scene(kind):
    own = {} if kind is DragForceTerm else {"length": 1.0}
    drag = CoulombField(scene(), deadband=DEADBAND)
    term = kind(scene(), 2.0, drag=drag, **own)
    neutral = term.with_neutral(["friction_coefficient"])
    assert set(neutral.assembled.blocks) == {"p"} and neutral.weight == 2.0
    expected = scene().W if own else scene().N
    assert abs(neutral.assembled.blocks["p"] - expected).max() < 1e-12
    assert term.with_neutral(["another"]) is term
