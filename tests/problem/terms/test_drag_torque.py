"""Measured torques with drag, over ℓ."""

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
from ttus_opt.problem.terms.drag_torque import DragTorqueTerm


def test_its_residual_is_contact_and_drag_s_moment_less_what_was_measured():
    """Drag acts at the contact: its moment is arm × drag."""
    model, length = GlobalCoulomb(scene(), "contact", DEADBAND, MU), 0.05
    rows = DragTorqueTerm(scene(), length=length, drag=model).assembled
    found = length * (rows.blocks["p"] @ field() - rows.target)
    moment = np.cross(model.sliding.arm, by_coulomb(model, MU))
    expected = contact()[1] + moment - scene().tau.reshape(-1, 3)
    np.testing.assert_allclose(found.reshape(-1, 3), expected, atol=1e-12)


def test_without_drag_its_rows_are_those_of_the_torque():
    model = CoulombField(scene(), deadband=DEADBAND)
    term = DragTorqueTerm(scene(), 2.0, length=1.0, drag=model)
    neutral = term.with_neutral(["friction_coefficient"])
    assert set(neutral.assembled.blocks) == {"p"} and neutral.weight == 2.0
    assert abs(neutral.assembled.blocks["p"] - scene().W).max() < 1e-12
    assert term.with_neutral(["another"]) is term
