"""Laplace's field corrected by measured forces and torques, eq. 10: the paper's own.

Source: R. Yeung, D. Black, S. E. Salcudean, Measurement and Potential Field-Based
Patient Modeling for Model-Mediated Tele-ultrasound (2025), eq. 10, at the weights that
suit the trilinear sampling and hard torsos (λ = 1).
"""

from __future__ import annotations

from typing import ClassVar

from ttus_opt.comparators.field_model import FieldModel


class Eq10(FieldModel):
    """The field of eq. 10."""

    name = "eq10"
    summary = "ours: eq. 10, Laplace and measured wrenches, λ = 1 (Yeung 2025)"
    formulation = "eq10"
    defaults: ClassVar = {"force_weight": 1.0, "torque_weight": 1.0}
