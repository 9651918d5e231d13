"""A common depth profile times a random variation over the patient.

p = φ(d) (1 + g), where φ is one function of the depth d below the surface, and g a
Gaussian field of standard deviation σ whose covariance is a Matérn covariance along the
surface times one along the depth. The term is −2 times the log density of g, up to a
constant: ‖R (p/φ − 1)‖²/σ².

See docs/method/formulations.md, Depth map.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np

from ttus_opt.contact.contact_size import size_slopes
from ttus_opt.contact.scene import Scene
from ttus_opt.core.arrays import Array
from ttus_opt.gaussian.matern import SeparableCovariance
from ttus_opt.problem.terms.base import AffineRows, Term
from ttus_opt.problem.terms.depth_map_estimate import PRIOR, DepthMapEstimate
from ttus_opt.problem.terms.depth_profile import (
    REFERENCE_DEPTH,
    DepthProfile,
    check_depth_map,
    voxel_depths,
)
from ttus_opt.problem.terms.structure import KnownCovariance, UncertainMean
from ttus_opt.voxmap.sampling import least_length
from ttus_opt.voxmap.voxmap import Voxmap

#: Smallest depth at which φ is evaluated, over a layer's thickness [–]: rows must be
#: finite at voxels on the surface
LEAST_DEPTH = 0.1

#: Prior standard deviation of the scale of φ, over the scale: unknown but for the
#: measurements [–]
SCALE_DEVIATION = 3.0


@dataclass(frozen=True)
class DepthMapTerm(Term):
    """Squares of the whitened relative departure from a depth profile [–].

    Attributes:
        profile: φ.
        deviation: σ, relative standard deviation of the field about φ [–].
        surface_length: Matérn length along the surface [m].
        length_ratio: Length around the patient over length along it; surface_length is
            their geometric mean [–].
        depth_length: Matérn length along the depth [m].
        log_evidence: That of the estimate behind it, up to a constant [–].
    """

    profile: DepthProfile = field(default=DepthProfile((1.0,), (1.0,)))
    deviation: float = 0.4
    surface_length: float = 0.03
    depth_length: float = 0.015
    length_ratio: float = 1.0
    log_evidence: float | None = field(default=None, compare=False)

    name = "depth_map"

    @classmethod
    def of(cls, scene: Scene, estimate: DepthMapEstimate) -> Self:
        """A term with the estimated values."""
        return cls(
            scene,
            profile=estimate.profile,
            deviation=estimate.deviation,
            surface_length=estimate.surface_length,
            depth_length=estimate.depth_length,
            length_ratio=estimate.length_ratio,
            log_evidence=estimate.log_evidence,
        )

    @property
    def formula(self) -> str:
        """The formula with φ, σ and the lengths."""
        root = np.sqrt(self.length_ratio)
        around, along = self.surface_length * root, self.surface_length / root
        return (
            f"‖R (p/φ − 1)‖²/σ², φ = {self.profile}, σ = {self.deviation:.3g}, lengths "
            f"{1e3 * around:.3g} mm around, {1e3 * along:.3g} along, "
            f"{1e3 * self.depth_length:.3g} deep"
        )

    def __post_init__(self) -> None:
        """Validate weight, deviation and lengths."""
        super().__post_init__()
        check_depth_map(
            self.scene.voxmap.grid,
            deviation=self.deviation,
            surface_length=self.surface_length,
            depth_length=self.depth_length,
            length_ratio=self.length_ratio,
        )

    @cached_property
    def mean(self) -> Array:
        """φ at every voxel, shape (V,) [unit of p]."""
        return voxel_profile(self.scene, self.profile)

    @property
    def covariance(self) -> SeparableCovariance:
        """That of σ φ g over the voxels."""
        lengths = self.surface_length, self.depth_length, self.length_ratio
        scale = self.deviation * self.mean
        return SeparableCovariance.over(self.scene.voxmap, scale, *lengths)

    def rows(self) -> AffineRows:
        """R diag(1/φ)/σ and R 1/σ."""
        covariance = self.covariance
        rows = covariance.rows
        tags = frozenset({KnownCovariance(covariance, self._uncertain_mean())})
        return AffineRows({"p": rows}, rows @ self.mean, tags)

    def _uncertain_mean(self) -> UncertainMean:
        """φ with its scale and its exponents unknown, and ℓ₀, as priors have them.

        The relative deviation of stiffness in bodies in general is the median of its
        prior, 40 %. Between persons Young's moduli at one site vary by 17 to 73 %
        (K. Isogai et al., J. Phys. Ther. Sci. 34 (2022) 777-783: subcutaneous tissue
        and muscle at light and firm load); between places of one abdomen, away from
        ribs, by less than between persons (R. Remus et al., Front. Bioeng. Biotechnol.
        12 (2024) 1384062).
        """
        log_depth = np.log(np.abs(signed_depth(self.scene.voxmap)) / REFERENCE_DEPTH)
        drift = [SCALE_DEVIATION * self.mean]
        for a, c in zip(self.profile.exponents, self.profile.coefficients, strict=True):
            part = replace(self.profile, exponents=(a,), coefficients=(1.0,))
            power = c * voxel_profile(self.scene, part)
            drift.append(PRIOR["exponent"][1] * a * log_depth * power)
        scene = self.scene
        slopes = size_slopes(scene.patches.spread, least_length(scene.sampling))
        return UncertainMean(
            np.stack(drift, axis=1),
            slopes,
            PRIOR["least_length"][1],
            self.deviation,
            PRIOR["deviation"],
            self.surface_length,
            PRIOR["shared_error"],
        )


def signed_depth(voxmap: Voxmap) -> Array:
    """Depth of every voxel below the skin, never zero, negative outside, (V,) [m]."""
    depth, least = voxel_depths(voxmap), LEAST_DEPTH * voxmap.grid.r_step
    return np.copysign(np.maximum(np.abs(depth), least), depth)


def voxel_profile(scene: Scene, profile: DepthProfile) -> Array:
    """A profile at every voxel, never zero, shape (V,) [unit of p]."""
    return profile(signed_depth(scene.voxmap))
