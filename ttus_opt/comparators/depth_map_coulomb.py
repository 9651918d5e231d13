"""A depth map with Coulomb drag: formulation `depth_map_coulomb`.

See docs/method.md, Depth map and friction.
"""

from __future__ import annotations

from ttus_opt.comparators.field_model import FieldModel


class DepthMapCoulomb(FieldModel):
    """A depth map with one friction coefficient."""

    name = "depth_map_coulomb"
    summary = "ours: depth map with Coulomb drag, by evidence"
    formulation = "depth_map_coulomb"
