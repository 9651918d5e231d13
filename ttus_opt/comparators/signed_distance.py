"""Point shell against a signed distance field, in its penalty form.

Each point of the probe at a depth d below the surface pushes along the probe's normal,

    f = k Σ_m a_m d(x_m) n̂_m,   τ = Σ_m (x_m − x_0) × f_m,

with the points' areas a_m, so that k does not depend on their number.

Source: H. Xu, J. Barbič, 6-DoF haptic rendering using continuous collision detection
between points and signed distance fields, IEEE Trans. Haptics 10 (2017) 151–161. Its
continuous collision detection is left out: it keeps points from passing through thin
bodies, and adds nothing at measured poses in a thick patient.
"""

from __future__ import annotations

from ttus_opt.comparators.base import OneStiffness
from ttus_opt.core.arrays import Array


class SignedDistance(OneStiffness):
    """Penalty by signed distance, one stiffness."""

    name = "signed_distance"
    summary = "point shell in a signed distance field, penalty (Xu, Barbič 2017)"

    def _unit_wrench(self, R: Array, at: Array) -> tuple[Array, int]:
        touch = self.geometry.touch(R, at)
        return touch.pushed(touch.depth), len(touch)
