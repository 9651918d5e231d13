"""The paper's own settings, for comparison; the defaults predict unseen presses better.

Pass them as keyword arguments: ``Voxmap.from_surface(surface, **VOXMAP)``,
``Scene.assemble(voxmap, shell, presses, **SCENE)`` and ``fit(scene, "eq10",
**WEIGHTS)``. ``ttus-opt fit --paper`` uses all three.

Source: Yeung, Black, Salcudean, Measurement and Potential Field-Based Patient Modeling
for Model-Mediated Tele-ultrasound (2025), eqs. 6, 7 and 10.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

#: Location of p = 0, for `ttus_opt.voxmap.voxmap.Voxmap.from_surface` and `ScenePlan`
VOXMAP: Mapping[str, Any] = MappingProxyType({"boundary": "staircase"})

#: Boundary values and sampling, for `contact.scene.Scene.assemble` and `ScenePlan`
SCENE: Mapping[str, Any] = MappingProxyType(
    {"inner": 1.0, "outer": 1.0, "sampling": "voxel-mean"}
)

#: λ_f = λ_τ, for `ttus_opt.fitting.batch.fit`
WEIGHTS: Mapping[str, float] = MappingProxyType(
    {"force_weight": 1e-4, "torque_weight": 1e-4}
)
