"""Runs of frames whose errors are alike: presses, and places within a press.

Standard errors of least squares follow from places (`PlaceErrors`): frames of a place
share what the model has wrong there, so that places are independent, not rows. Let u be
the weighted residuals of the measured rows, H their derivatives with respect to the
parameters c along the profile, all else fitted anew, and C = (J'')⁻¹ the inverse
Hessian of the profile J(c). An error e of the rows moves ĉ by 2 C Hᵀe, so that they
have the share ω_a = 2 ‖(H C)_a‖²/C_aa in the variance s_a² of ĉ_a for independent rows;
the rest is the prior's. With the sums over a place in place of the measured rows
(cluster-robust, "sandwich" variance)

    var ĉ_a = (1 - ω_a) s_a² + κ n/(n - 1) Σ_k (2 Σ_{i∈k} u_i (H C)_ia)².

u is taken less its projection onto (H C)_a, as a parameter at its limit or beside the
optimum leaves residuals that are no errors. κ = m σ̂²/‖u‖² makes up for the part of the
errors that the field takes up, and n = (Σ w_k)²/Σ w_k² is the effective number of
places, w_k the share of a place in ‖(H C)_a‖². By chance this is too small where places
have nothing in common; the larger one of both errors is reported.

Source: K.-Y. Liang, S. L. Zeger, Biometrika 73 (1986), 13; A. C. Cameron, D. L. Miller,
J. Human Resources 50 (2015), 317; J. D. Angrist, J.-S. Pischke, Mostly Harmless
Econometrics (2009), sec. 8.2 (the larger one). See docs/method/identification.md,
Standard errors.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ttus_opt.core.arrays import Array, IntArray, Mask

#: Largest distance of the probe from the start of a place [m]
PLACE = 0.03


def runs(touching: Mask, segment: IntArray) -> IntArray:
    """Number of every frame's run, in contact or in the air, shape (T,).

    Args:
        touching: Whether a frame is in contact, shape (T,).
        segment: Recording of every frame, shape (T,) [–].
    """
    begins = (np.diff(touching.astype(np.int8)) != 0) | (np.diff(segment) != 0)
    return np.concatenate([[0], np.cumsum(begins)]).astype(np.int64)


def places(press: IntArray, position: Array, size: float = PLACE) -> IntArray:
    """Number of every frame's place, shape (T,).

    A place is a run of frames of one press within ``size`` of its first position.

    Args:
        press: Press of every frame, shape (T,) [–].
        position: Position of the probe, shape (T, 3) [m].
        size: Largest distance from the first position [m].
    """
    out, number, start = np.zeros(len(press), dtype=np.int64), 0, 0
    for t in range(1, len(press)):
        away = float(np.linalg.norm(position[t] - position[start]))
        if press[t] != press[start] or away > size:
            number, start = number + 1, t
        out[t] = number
    return out


#: Fewest effective places: the standard error itself is then known to a third [–]
LEAST_PLACES = 5.0

#: Share of the measured rows in the variance below which places do not matter [–]
LEAST_SHARE = 0.1

#: What is remarked of errors for independent rows
UNKNOWN = "standard error for independent frames: too few places to tell"


@dataclass(frozen=True)
class PlaceErrors:
    """Standard errors, and remarks on them.

    Attributes:
        errors: Shape (k,).
        remarks: `UNKNOWN` where places are too few; k of them.
    """

    errors: Array
    remarks: tuple[str, ...] = field(repr=False)


def place_errors(
    usual: Array, rest: Array, pull: Array, scale: Array, place: IntArray
) -> PlaceErrors:
    """Standard errors that allow for what a place has in common.

    Args:
        usual: Standard errors s for independent rows, shape (k,).
        rest: u of rows in contact, shape (m,).
        pull: H C, shape (m, k).
        scale: Diagonal of C, shape (k,).
        place: Place of every row, shape (m,) [–].
    """
    moved = 2.0 * _summed(rest[:, None] * pull, place)
    shares = _summed(pull**2, place)
    total = shares.sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        moved -= shares * moved.sum(axis=0) / total
        count = total**2 / (shares**2).sum(axis=0)
        measured = np.minimum(2.0 * total / scale, 1.0)
        taken_up = len(rest) * usual**2 / (2.0 * scale) / float(rest @ rest)
        squares = taken_up * count / (count - 1.0) * (moved**2).sum(axis=0)
        shared = np.sqrt((1.0 - measured) * usual**2 + squares)
    matters = measured >= LEAST_SHARE
    told = matters & (count >= LEAST_PLACES) & np.isfinite(shared)
    errors = np.where(told, np.maximum(usual, shared), usual)
    return PlaceErrors(errors, remarks_of(matters & ~told))


def remarks_of(unknown: Mask) -> tuple[str, ...]:
    """`UNKNOWN` where it is true, else nothing."""
    return tuple(UNKNOWN if one else "" for one in unknown)


def _summed(values: Array, place: IntArray) -> Array:
    """Sums over the rows of every place, shape (places, k)."""
    sums = np.zeros((int(place.max(initial=-1)) + 1, values.shape[1]))
    np.add.at(sums, place, values)
    return sums
