"""How contact samples a field: names, units, and the length of ``contact-size``.

``contact-size:0.018`` is ``contact-size`` (`ttus_opt.contact.contact_size`) with
ℓ₀ = 18 mm: a patch that is much shorter samples as ``trilinear`` does, of one that is
much longer the stiffness per area decreases like 1/ℓ. See docs/method/contact.md.
"""

from __future__ import annotations

import math

from ttus_opt.core import io
from ttus_opt.core.errors import InputError

#: Unit of the field for each sampling (docs/method/contact.md, Unit of the field)
FIELD_UNIT: dict[str, str] = {
    "voxel-mean": "N",
    "trilinear": "N cm-2",
    "contact-size": "N cm-2",
}

SIZED = "contact-size"

#: ℓ₀ where none is given [m]
LEAST_LENGTH = 0.005

#: Smallest and largest ℓ₀: of a grain of sand, of a patient [m]
LENGTHS = 1e-4, 1.0


def check_sampling(sampling: str) -> None:
    """Check the name of a sampling.

    Raises:
        InputError: There is no such sampling, or its length is not usable.
    """
    name, _, length = sampling.partition(":")
    if name not in FIELD_UNIT or (":" in sampling and name != SIZED):
        raise InputError(
            f"sampling must be one of {', '.join(FIELD_UNIT)}, {SIZED}:LENGTH in m, "
            f"got {io.shortened(sampling)}"
        )
    if ":" in sampling and not LENGTHS[0] <= _number(length) <= LENGTHS[1]:
        raise InputError(
            f"the length of {SIZED}:LENGTH must be {LENGTHS[0]:g} to {LENGTHS[1]:g} m, "
            f"got {io.shortened(length)}"
        )


def sized(length: float) -> str:
    """``contact-size`` with ℓ₀ in m, to three digits."""
    return f"{SIZED}:{length:.3g}"


def least_length(sampling: str) -> float:
    """ℓ₀ [m]; 0 where the size of a contact does not count."""
    name, _, length = sampling.partition(":")
    if name != SIZED:
        return 0.0
    return float(length) if length else LEAST_LENGTH


def field_unit(sampling: str) -> str:
    """Unit of a field."""
    return FIELD_UNIT[sampling.partition(":")[0]]


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
