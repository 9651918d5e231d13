"""Laplace priors: penalties of the rows of L, of some of them, or of a variant of L.

See docs/method/formulations.md, The shelf, and docs/method/contact.md, Variants
and Friction.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np
import scipy.sparse as sp

from ttus_opt.contact.scene import BOUNDARY_SCALE
from ttus_opt.core.arguments import expect_between, expect_positive
from ttus_opt.core.arrays import Array
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.problem.terms.base import AffineRows, Fitted, Term
from ttus_opt.problem.terms.depth_profile import DepthProfile, voxel_depths
from ttus_opt.problem.terms.penalties import Absolute
from ttus_opt.problem.terms.structure import LaplaceRows, Tag, Tags


@dataclass(frozen=True)
class LaplaceTerm(Term):
    """Squares of the scaled Laplace rows, Dirichlet rows included (soft).

    Attributes:
        factor: s, on the scene's boundary values [–].
    """

    factor: float = 1.0

    name = "laplace"

    @property
    def formula(self) -> str:
        """The formula, with the factor on b unless it is 1."""
        factor = "" if self.factor == 1.0 else f"{self.factor:.4g} "
        return f"‖L p − {factor}b‖²"

    def __post_init__(self) -> None:
        """Validate weight and factor."""
        super().__post_init__()
        expect_positive(self.factor, "factor on b")

    def with_factor(self, factor: float) -> Self:
        """The same prior with its boundary values times a factor."""
        return replace(self, factor=factor)

    def rows(self) -> AffineRows:
        """L and s b of the scene."""
        tags = frozenset({LaplaceRows("p")})
        return AffineRows({"p": self.scene.L}, self.factor * self.scene.b, tags)

    def parameters(self, values: Mapping[str, Array]) -> dict[str, float]:
        """The boundary scale, if the scene has fitted one."""
        if BOUNDARY_SCALE not in self.scene.parameters:
            return {}
        return {BOUNDARY_SCALE: self.factor * self.scene.parameters[BOUNDARY_SCALE]}


@dataclass(frozen=True)
class LaplaceFreeSurfaceTerm(Term):
    """Squares of the Laplace rows, with a small weight on those of the surface layer.

    With p = 0 on the surface the force on a round tip grows like depth²; on real tissue
    it grows like depth¹ to depth^1.5 and begins at first touch. The small weight
    determines the field where nothing was measured (the Laplace field of eq. 8) and
    hardly matters elsewhere. Both end slices keep their values.

    Attributes:
        skin: Factor on the weight of the layer's rows; with 0 the field is undetermined
            where nothing was measured [–].
    """

    skin: float = 1e-3

    name = "laplace_free_surface"
    formula = "‖L p − b‖² without the surface's rows"

    def __post_init__(self) -> None:
        """Validate weight and the layer's share."""
        super().__post_init__()
        expect_between(self.skin, 0.0, 1.0, "skin")

    def rows(self) -> AffineRows:
        """L and b with the surface layer's rows scaled by √skin."""
        scene = self.scene
        scale = np.ones(scene.n_voxels)
        layer = free_surface_layer(scene.voxmap.on_surface)
        if scene.voxmap.grid.wall is not None:
            layer[:, scene.voxmap.grid.wall] = False
        layer = layer.reshape(-1)
        scale[layer] = math.sqrt(self.skin)
        rows = sp.csr_array(sp.diags_array(scale) @ scene.L)
        rows.eliminate_zeros()
        tags = frozenset({LaplaceRows("p", scale)} if self.skin > 0.0 else ())
        return AffineRows({"p": rows}, scale * scene.b, tags)


def free_surface_layer(on_surface: np.ndarray) -> np.ndarray:
    """The surface layer without both end slices, shape (n_r, n_theta, n_z)."""
    layer = on_surface.copy()
    layer[:, :, [0, -1]] = False
    layer[[0, -1]] = False
    return layer


@dataclass(frozen=True)
class LaplaceResidualTerm(Term):
    """Squares of the Laplace rows of p − φ, Dirichlet rows included (soft).

    φ is one function of the depth d below the surface. The boundary rows of L hold the
    field at φ: at zero on the skin, at the profile's value on the inner layer, and at
    −φ(|d|) outside. The scene's boundary values are not used.

    Attributes:
        profile: φ.
    """

    profile: DepthProfile = field(default=DepthProfile((1.0,), (1.0,)))

    name = "laplace_residual"

    @property
    def formula(self) -> str:
        """The formula with φ."""
        return f"‖L (p − φ)‖², φ = {self.profile}"

    @cached_property
    def mean(self) -> Array:
        """φ at every voxel, zero on the surface layer, shape (V,) [unit of p]."""
        voxmap = self.scene.voxmap
        at_voxels = self.profile(voxel_depths(voxmap))
        return np.where(voxmap.on_surface.ravel(), 0.0, at_voxels)

    def rows(self) -> AffineRows:
        """L and L φ."""
        L = self.scene.L
        tags: Tags = frozenset({LaplaceRows("p"), Tag.OWN_MEAN})
        return AffineRows({"p": L}, L @ self.mean, tags)


#: Unit of length of the integral, ℓ [m]
LENGTH = 0.01


@dataclass(frozen=True)
class VolumeWeightedTerm(Term):
    """Squares of ∇²p over the free voxels, times their volume.

    Eq. 10 sums squares of Δr² ∇²p over voxels: halving every step halves that sum (2⁻⁴
    for each voxel, 2³ times as many), so that the meaning of λ depends on the grid.
    Here it does not. Boundary values are not part of the integral: they belong in a
    constraint.
    """

    name = "volume_weighted"
    formula = "∫ (ℓ²∇²p)² dV/ℓ³"

    def rows(self) -> AffineRows:
        """Free rows of L, each times √(volume/ℓ³)·(ℓ/Δr)²."""
        laplace = self.scene.laplace
        grid, free = laplace.grid, np.flatnonzero(laplace.free)
        volume = laplace.radii * grid.r_step * grid.theta_step * grid.z_step
        of_voxels = np.sqrt(volume / LENGTH**3) * (LENGTH / grid.r_step) ** 2
        scale = of_voxels[free]
        rows = sp.csr_array(sp.diags_array(scale) @ laplace.L[free])
        tags = frozenset({LaplaceRows("p", of_voxels)})
        return AffineRows({"p": rows}, scale * self.scene.b[free], tags)


@dataclass(frozen=True)
class SparseSourcesTerm(Term):
    """Absolute values of the scaled Laplace rows of free voxels, no Dirichlet rows.

    L p − b are the sources and sinks of the field between the boundaries. Squares
    spread them over all voxels; absolute values concentrate them in few, such as a
    rib's edge.
    """

    name = "sparse_sources"
    formula = "Σ |L p − b| over free voxels"
    penalty = Absolute()

    def rows(self) -> AffineRows:
        """Free rows of L and b."""
        free = np.flatnonzero(self.scene.laplace.free)
        tag = LaplaceRows(scale=np.ones(self.scene.n_voxels))
        rows = {"p": self.scene.L[free]}
        return AffineRows(rows, self.scene.b[free], frozenset({tag}))


@dataclass(frozen=True)
class _VariantTerm(Term):
    """Squares of the rows of a variant of L, Dirichlet rows included (soft)."""

    @property
    @abc.abstractmethod
    def system(self) -> LaplaceSystem:
        """The variant."""

    def rows(self) -> AffineRows:
        """The variant and its b, whose end slices are solved by it too."""
        system = self.system
        target = system.right_side(self.scene.inner, self.scene.outer)
        tags = frozenset({LaplaceRows("p", system=system)})
        return AffineRows({"p": system.L}, target, tags)


@dataclass(frozen=True)
class AnisotropicTerm(_VariantTerm):
    """Squares of the anisotropic Laplace rows, ‖Δr² ∇·(K ∇p) − b‖².

    Muscle and skin carry load further along one direction than across it; each
    conductivity is constant along its coordinate.

    Attributes:
        conductivities: k_r, k_θ, k_z [–].
    """

    conductivities: tuple[float, float, float] = (1.0, 1.0, 1.0)

    name = "anisotropic"

    @property
    def formula(self) -> str:
        """The formula with the conductivities."""
        given = ", ".join(f"{k:g}" for k in self.conductivities)
        return f"‖L(k = {given}) p − b‖²"

    @property
    def system(self) -> LaplaceSystem:
        """The anisotropic operator."""
        return self.scene.laplace.variant(conductivities=self.conductivities)


@dataclass(frozen=True)
class ScreenedTerm(_VariantTerm):
    """Squares of the screened Laplace (Helmholtz) rows, ‖Δr²(∇²p − κ²p) − b‖².

    The boundary's influence decays over the length 1/κ: the field flattens with depth,
    as if tissue farther than 1/κ away did not push back.

    Attributes:
        screening: κ [1/m].
    """

    screening: float = 10.0

    name = "screened"

    @property
    def formula(self) -> str:
        """The formula with κ."""
        return f"‖(L − Δr²κ²) p − b‖², κ = {self.screening:g}/m"

    @property
    def system(self) -> LaplaceSystem:
        """The screened operator."""
        return self.scene.laplace.variant(screening=self.screening)


#: Name of m among the parameters of a fitted field
MEAN_FRICTION = "mean_friction_coefficient"


@dataclass(frozen=True)
class DragSmoothnessTerm(Term):
    """Prior of the drag field q: squares of its scaled Laplace rows (soft).

    Measurements determine q only where the probe slid. Where friction is the same
    everywhere q = μ p, which satisfies L q = μ b as p satisfies L p = b. Elsewhere q
    therefore follows a mean friction coefficient m times p, and m is found with it.

    Attributes:
        has_mean: Whether m is a variable; otherwise it is 0.
    """

    has_mean: bool = True

    name = "drag_smoothness"

    @property
    def formula(self) -> str:
        """The formula with or without m."""
        return "‖L q − m b‖²" if self.has_mean else "‖L q‖²"

    def rows(self) -> AffineRows:
        """L over q, and -b over the mean friction coefficient m."""
        b = self.scene.b
        mean = {"m": sp.csr_array(-b[:, None])} if self.has_mean else {}
        tags = frozenset({LaplaceRows("q", beside=tuple(mean))})
        return AffineRows({"q": self.scene.L, **mean}, np.zeros(len(b)), tags)

    def parameters(self, values: Mapping[str, Array]) -> dict[str, float]:
        """The mean friction coefficient."""
        return {MEAN_FRICTION: float(values["m"][0]) if self.has_mean else 0.0}

    def fitted(self, values: Mapping[str, Array]) -> dict[str, Fitted]:
        """The coefficient m, with span 1: drag then equals the normal force."""
        return {MEAN_FRICTION: Fitted({"m": np.ones(1)}, 1.0)} if self.has_mean else {}

    def with_neutral(self, names: Collection[str]) -> Self:
        """The same prior, with m = 0 if it is among the names."""
        return replace(self, has_mean=False) if MEAN_FRICTION in names else self
