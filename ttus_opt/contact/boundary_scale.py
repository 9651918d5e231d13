"""The scale of the boundary values, identified from measured forces.

The Laplace field is linear in p_in where the ratio p_out / p_in is kept, so the scale
that matches the forces best is one number by least squares
(docs/method/formulations.md, 8.4).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from ttus_opt.contact.places import place_errors
from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.errors import InputError, MistakeWarning, TtusWarning, warn
from ttus_opt.laplace.system import LaplaceSystem

#: Name of the parameter in a scene and a solution
BOUNDARY_SCALE = "boundary_scale"

#: Largest relative standard error of an identified scale, which is then two standard
#: errors from zero [–]
LARGEST_SCALE_ERROR = 0.5


class Identified(NamedTuple):
    """Parameters identified by assembling a scene, by name.

    Attributes:
        parameters: Their values.
        standard_errors: Their standard errors.
        not_identified: Why one is not identified.
    """

    parameters: dict[str, float]
    standard_errors: dict[str, float]
    not_identified: dict[str, str]


def identified_scale(
    laplace: LaplaceSystem,
    N: sp.csr_array,
    place: IntArray,
    force: Array,
    outer: float,
    asked: bool,
) -> Identified:
    """The boundary scale; 1 where the forces do not determine it.

    Args:
        laplace: L.
        N: Force rows, shape (3T, V).
        place: Place of every pose, -1 without contact, shape (T,) [–].
        force: Measured forces, shape (3T,) [N].
        outer: The ratio p_out / p_in [–].
        asked: Whether a negative scale is an error instead of a warning.

    Raises:
        InputError: There is no force in contact, or the forces push into the patient
            and ``asked`` is true.
    """
    scale, error = _boundary_scale(laplace, N, place, force, outer)
    if asked and scale <= 0.0:
        raise InputError(
            f'inner="fit" found a boundary scale of {scale:.3g}: the measured forces '
            "push into the patient: give the force ON the probe in patient axes"
        )
    if error <= LARGEST_SCALE_ERROR * scale:
        return Identified({BOUNDARY_SCALE: scale}, {BOUNDARY_SCALE: error}, {})
    reason = _report_scale(scale, error)
    return Identified({BOUNDARY_SCALE: 1.0}, {}, {BOUNDARY_SCALE: reason})


def _boundary_scale(
    laplace: LaplaceSystem,
    N: sp.csr_array,
    place: IntArray,
    force: Array,
    outer: float,
) -> tuple[float, float]:
    """Scale s that minimises ‖s N p₁ - f‖² with p₁ the Laplace field of unit p_in.

    Returns:
        s and its standard error σ̂/‖N p₁‖ with σ̂² = ‖s N p₁ - f‖²/(m - 1), m force rows
        in contact; inf where m = 1. That by places (`ttus_opt.contact.places`)
        where it is larger.
    """
    unit = N @ laplace.solve(laplace.right_side(1.0, outer))
    square = float(unit @ unit)
    if square == 0.0:
        raise InputError(
            'inner="fit" needs measured forces in contact, but the probe never '
            "touches the patient, or too lightly for the sampling on this grid: check "
            "the recordings' frame and unit, or give inner as a number"
        )
    scale = float(unit @ force) / square
    rows = np.repeat(place, 3)
    contact = rows >= 0
    rest = (scale * unit - force)[contact]
    freedom = len(rest) - 1
    variance = float(rest @ rest) / freedom if freedom > 0 else np.inf
    inverse = np.array([0.5 / square])
    usual = np.array([np.sqrt(variance / square)])
    if not np.isfinite(variance):
        return scale, np.inf
    known = place_errors(
        usual, rest, unit[contact, None] * inverse, inverse, rows[contact]
    )
    return scale, float(known.errors[0])


def _report_scale(scale: float, error: float) -> str:
    """Warn of a boundary scale that the forces do not determine; return the reason."""
    kind = TtusWarning
    reason = f"the forces give {scale:.3g} ± {error:.2g}"
    advice = "record more contact, or give inner as a number"
    if scale < -2.0 * error:
        reason = f"the forces push into the patient ({scale:.3g} ± {error:.2g})"
        advice = "give the force ON the probe in patient axes"
        kind = MistakeWarning
    warn(
        f"the recordings cannot determine the boundary scale ({reason}), so 1 is "
        f"used: {advice}",
        3,
        kind=kind,
    )
    return reason
