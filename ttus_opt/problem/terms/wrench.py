"""Measured wrenches, λ_f ‖N p − f‖² and λ_τ ‖(W p − τ)/ℓ‖² (paper eqs. 6, 7, 10).

N and N·m differ by a length: torque rows are divided by a characteristic length ℓ, by
default the shell's root-mean-square radius, so that λ_τ is comparable with λ_f.

See docs/method/formulations.md, Eq. 10 and Penalties, and docs/method/friction.md.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.problem.terms.base import AffineRows, Fitted, Term
from ttus_opt.problem.terms.drag import DragModel
from ttus_opt.problem.terms.part_noise import PartNoise, whitened
from ttus_opt.problem.terms.penalties import Huber


@dataclass(frozen=True)
class ForceTerm(Term):
    """Squares of the force residuals of every frame [N²].

    Attributes:
        noise: Relative errors of normal and tangential forces, by which residuals are
            divided; None for equal ones.
    """

    noise: PartNoise | None = field(default=None, kw_only=True)

    name = "force"
    formula = "‖N p − f‖²"
    measures = True

    def rows(self) -> AffineRows:
        """N and f of the scene."""
        return self._measured({"p": self.scene.N})

    def _measured(self, blocks: Mapping[str, sp.csr_array]) -> AffineRows:
        """Rows by variable and the measured forces, over their relative errors."""
        if self.noise is None:
            return AffineRows(blocks, self.scene.f)
        return whitened(self.noise.force, blocks, self.scene.f)


@dataclass(frozen=True)
class RobustForceTerm(Term):
    """Huber's penalty of every component of every force residual [N²].

    Up to δ the penalty is the square, as in eq. 10, beyond it proportional to the
    residual, so that slipping, hair and cable pulls do not distort the field.

    Attributes:
        limit: δ, the largest squared residual; about twice the sensor noise and model
            error together [N].
    """

    limit: float = 0.5

    name = "robust_force"
    measures = True

    @property
    def formula(self) -> str:
        """The formula with δ."""
        return f"Σ huber(N p − f; {self.limit:g} N)"

    def __post_init__(self) -> None:
        """Validate weight and limit."""
        super().__post_init__()
        if not (math.isfinite(self.limit) and self.limit > 0.0):
            raise InputError(
                f"robust_force limit must be positive [N], got {self.limit}"
            )

    @property
    def penalty(self) -> Huber:
        """Huber's, with δ [N]."""
        return Huber(self.limit)

    def rows(self) -> AffineRows:
        """N and f of the scene."""
        return AffineRows({"p": self.scene.N}, self.scene.f)


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


@dataclass(frozen=True)
class _Dragged(Term):
    """A term with a drag model, whose coefficients may be at 0."""

    drag: DragModel = field(kw_only=True, repr=False)

    def with_neutral(self, names: Collection[str]) -> Self:
        """The same term with these drag coefficients at 0."""
        drag = self.drag.with_neutral(names)
        return self if drag is self.drag else replace(self, drag=drag)


@dataclass(frozen=True)
class DragForceTerm(_Dragged, ForceTerm):
    """Squares of the force residuals with drag, of every frame [N²].

    Attributes:
        drag: The drag model.
    """

    name = "force"

    @property
    def formula(self) -> str:  # type: ignore[override]
        """The formula with the drag subtracted."""
        return f"‖N p − {self.drag.formula} − f‖²"

    def rows(self) -> AffineRows:
        """N and the rows of drag by variable, and f."""
        return self._measured(self.drag.force_blocks())

    def parameters(self, values: Mapping[str, Array]) -> dict[str, float]:
        """The drag coefficients."""
        return self.drag.parameters(values)

    def fitted(self, values: Mapping[str, Array]) -> dict[str, Fitted]:
        """The drag coefficients that are variables."""
        return self.drag.fitted(values)

    def not_identifiable(self) -> dict[str, str]:
        """The drag coefficients that no pose determines."""
        return self.drag.not_identifiable()


@dataclass(frozen=True)
class DragTorqueTerm(_Dragged, TorqueTerm):
    """Squares of the torque residuals over ℓ with drag, of every frame [N²].

    Attributes:
        drag: The drag model.
    """

    name = "torque"

    @property
    def formula(self) -> str:  # type: ignore[override]
        """The formula with the torque of drag subtracted."""
        drag = self.drag.formula.replace("F", "G")
        return f"‖(W p − {drag} − τ)/ℓ‖²"

    def rows(self) -> AffineRows:
        """W/ℓ and the rows of drag by variable, and τ/ℓ."""
        return self._measured(self.drag.torque_blocks())
