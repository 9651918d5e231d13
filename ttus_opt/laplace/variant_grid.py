"""The grid on which a variant of Laplace's operator is the plain one.

With conductivities k the stencil is k_r times the plain one on a grid whose steps along
θ and z are multiplied by √(k_r/k_θ) and √(k_r/k_z), as these enter only as Δr²/Δθ² and
Δr²/Δz². The multigrid of the plain operator, whose coarsening follows the steps, then
solves the variant.
"""

from __future__ import annotations

from dataclasses import dataclass

from ttus_opt.voxmap.grid import CylindricalGrid


@dataclass(frozen=True)
class VariantGrid(CylindricalGrid):
    """A grid with other steps along θ and z, for operators, not for positions.

    Attributes:
        theta_stretch: Factor of Δθ [–].
        z_stretch: Factor of Δz [–].
    """

    theta_stretch: float = 1.0
    z_stretch: float = 1.0

    @property
    def theta_step(self) -> float:
        """Angular step times its factor [rad]."""
        return super().theta_step * self.theta_stretch

    @property
    def z_step(self) -> float:
        """Step along the axis times its factor [m]."""
        return super().z_step * self.z_stretch
