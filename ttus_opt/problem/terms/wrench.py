"""Measured wrenches, λ_f ‖N p − f‖² and λ_τ ‖(W p − τ)/ℓ‖² (paper eqs. 6, 7, 10).

N and N·m differ by a length: torque rows are divided by a characteristic length ℓ, by
default the shell's root-mean-square radius, so that λ_τ is comparable with λ_f.

See docs/method/formulations.md, Eq. 10 and Penalties, and docs/method/friction.md.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arguments import expect_between, expect_positive
from ttus_opt.core.arrays import Array
from ttus_opt.problem.terms.base import AffineRows, Fitted, Term
from ttus_opt.problem.terms.drag import DragModel
from ttus_opt.problem.terms.part_noise import PartNoise, whitened
from ttus_opt.problem.terms.penalties import Huber


@dataclass(frozen=True)
class _Measured(Term):
    """Measured wrenches, with drag or without, whose coefficients may be at 0."""

    noise: PartNoise | None = field(default=None, kw_only=True)
    drag: DragModel | None = field(default=None, kw_only=True, repr=False)

    measures = True

    def with_neutral(self, names: Collection[str]) -> Self:
        """The same term with these drag coefficients at 0."""
        drag = None if self.drag is None else self.drag.with_neutral(names)
        return self if drag is self.drag else replace(self, drag=drag)


@dataclass(frozen=True)
class ForceTerm(_Measured):
    """Squares of the force residuals of every frame [N²].

    Attributes:
        noise: Relative errors of normal and tangential forces, by which residuals are
            divided; None for equal ones.
        drag: The drag model; None for contact without friction.
    """

    name = "force"

    @property
    def formula(self) -> str:
        """The formula, with the drag subtracted."""
        return f"‖N p − {f'{self.drag.formula} − ' if self.drag else ''}f‖²"

    def rows(self) -> AffineRows:
        """N and the rows of drag by variable, and f, over relative errors."""
        scene, drag, noise = self.scene, self.drag, self.noise
        blocks = (
            {"p": scene.N} if drag is None else drag.beside(scene.N, drag.rows.force)
        )
        if noise is None:
            return AffineRows(blocks, scene.f)
        return whitened(noise.force, blocks, noise.expected(scene.f))

    def parameters(self, values: Mapping[str, Array]) -> dict[str, float]:
        """The drag coefficients."""
        return {} if self.drag is None else self.drag.parameters(values)

    def fitted(self, values: Mapping[str, Array]) -> dict[str, Fitted]:
        """The drag coefficients that are variables."""
        return {} if self.drag is None else self.drag.fitted(values)

    def not_identifiable(self) -> dict[str, str]:
        """The drag coefficients that no pose determines."""
        return {} if self.drag is None else self.drag.not_identifiable()


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
        expect_positive(self.limit, "robust_force limit", "N")

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
class TorqueTerm(_Measured):
    """Squares of the torque residuals over ℓ, of every frame [N²].

    It has no rows if only forces were measured.

    Attributes:
        length: ℓ [m]; None takes the shell's root-mean-square radius, 1.0 is the
            literal SI form, in which torque has practically no weight.
        noise: Relative errors of the frames, by which residuals are divided; None for
            equal ones.
        drag: The drag model; None for contact without friction.
    """

    length: float | None = None

    name = "torque"

    def __post_init__(self) -> None:
        """Validate weight and length."""
        super().__post_init__()
        if self.length is not None:
            expect_between(self.length, *LENGTHS, "torque_length", "m")

    @property
    def formula(self) -> str:
        """The formula, with the torque of drag subtracted."""
        drag = "" if self.drag is None else f"{self.drag.formula} − ".replace("F", "G")
        return f"‖(W p − {drag}τ)/ℓ‖²"

    def rows(self) -> AffineRows:
        """W/ℓ and the rows of drag by variable, and τ/ℓ, over relative errors."""
        scene, drag, noise = self.scene, self.drag, self.noise
        blocks = (
            {"p": scene.W} if drag is None else drag.beside(scene.W, drag.rows.torque)
        )
        if scene.measures_force_only:
            return AffineRows({k: M[:0] for k, M in blocks.items()}, np.zeros(0))
        scale = 1.0 / (self.length or scene.torque_length)
        by = sp.eye_array(len(scene.tau), format="csr")
        if noise is not None:
            by = noise.torque
        return whitened(scale * by, blocks, scene.tau)
