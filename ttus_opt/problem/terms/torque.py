"""Measured torques, λ_τ ‖(W p - τ)/ℓ‖² (paper eqs. 7, 10).

N and N·m differ by a length: rows are divided by a characteristic length ℓ, by
default the shell's root-mean-square radius, so that λ_τ is comparable with λ_f.

See docs/method/formulations.md, Eq. 10.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.errors import InputError
from ttus_opt.problem.terms.base import AffineRows, Term
from ttus_opt.problem.terms.part_noise import PartNoise, whitened

#: Range of ℓ [m]: below it only torque counts, above it torque has no weight at all,
#: whatever the probe
LENGTHS = (1e-6, 1e6)


@dataclass(frozen=True)
class TorqueTerm(Term):
    """Squares of the torque residuals over ℓ, of every frame [N²].

    It has no rows if only forces were measured.

    Attributes:
        length: ℓ [m]; None takes the shell's root-mean-square radius, 1.0 is the
            literal SI form, in which torque has practically no weight.
        noise: Relative errors of the frames, by which residuals are divided; None for
            equal ones.
    """

    length: float | None = None
    noise: PartNoise | None = field(default=None, kw_only=True)

    name = "torque"
    formula = "‖(W p − τ)/ℓ‖²"
    measures = True

    def __post_init__(self) -> None:
        """Validate weight and length."""
        super().__post_init__()
        low, high = LENGTHS
        if self.length is not None and not low <= self.length <= high:
            raise InputError(
                f"torque_length must lie between {low:g} and {high:g} m, got "
                f"{self.length}"
            )

    def rows(self) -> AffineRows:
        """W/ℓ and τ/ℓ of the scene."""
        return self._measured({"p": self.scene.W})

    def _measured(self, blocks: Mapping[str, sp.csr_array]) -> AffineRows:
        """Rows by variable and the measured torques, over ℓ and relative errors."""
        if self.scene.measures_force_only:
            return AffineRows({k: M[:0] for k, M in blocks.items()}, np.zeros(0))
        scale = 1.0 / (self.length or self.scene.torque_length)
        if self.noise is None:
            by = scale * sp.eye_array(len(self.scene.tau), format="csr")
        else:
            by = scale * self.noise.torque
        return whitened(by, blocks, self.scene.tau)
