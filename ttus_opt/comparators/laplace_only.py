"""Laplace's equation alone: the field before any measurement, scaled to the forces.

Source: R. Yeung, D. Black, S. E. Salcudean, Measurement and Potential Field-Based
Patient Modeling for Model-Mediated Tele-ultrasound (2025), eq. 8; its boundary value is
picked by hand, here the one that fits the measured forces best.
"""

from __future__ import annotations

from ttus_opt.comparators.field_model import FieldModel


class LaplaceOnly(FieldModel):
    """The Laplace field, one boundary value."""

    name = "laplace_only"
    summary = "Laplace's field scaled to the forces (Yeung and others 2025, eq. 8)"
    formulation = "laplace_only"
