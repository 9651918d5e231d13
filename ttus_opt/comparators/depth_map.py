"""One curve of the depth times what varies over the patient: formulation `depth_map`.

See docs/method.md, Depth map; its hyperparameters are chosen by evidence.
"""

from __future__ import annotations

from ttus_opt.comparators.field_model import FieldModel


class DepthMap(FieldModel):
    """A depth map without friction."""

    name = "depth_map"
    summary = "ours: depth profile times a Gaussian field, by evidence"
    formulation = "depth_map"
