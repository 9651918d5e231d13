"""The potential field of this package as a comparator, by its formulation's name.

Grid, sampling and boundary scale are the package's defaults; the wrench is that of
`ttus_opt.Renderer`, compiled.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Unpack

import numpy as np

from ttus_opt.arrays import Array
from ttus_opt.comparators.base import Comparator, Given
from ttus_opt.fitting.batch import fit
from ttus_opt.haptic.renderer import Renderer
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.problem.solution import Solution
from ttus_opt.scene import Scene, ScenePlan


class FieldModel(Comparator):
    """A fitted potential field.

    Attributes:
        formulation: Its name.
        plan: Grid and sampling.
        options: The formulation's own.
        solution: After `fit`.
    """

    formulation: ClassVar[str] = ""
    defaults: ClassVar[dict[str, Any]] = {}

    def __init__(
        self,
        *,
        shape: Sequence[int] = (48, 120, 60),
        r_inner: float = 0.03,
        **given: Unpack[Given],
    ) -> None:
        super().__init__(**given)
        self.plan = ScenePlan(shape=shape, r_inner=r_inner, inner="fit")
        self.solution: Solution | None = None

    def parameters(self) -> dict[str, float]:
        """What was identified beside the field."""
        return {} if self.solution is None else dict(self.solution.parameters)

    def _fit(self, recording: Trajectory, force: Array) -> None:
        scene = self.plan.build(self.surface, self.shell, recording)
        self.solution = self._solved(scene)
        self._renderer = Renderer(self.solution.field, self.shell)

    def _solved(self, scene: Scene) -> Solution:
        """The fit of the formulation."""
        return fit(scene, self.formulation, **self.defaults)

    def _wrench(self, R: Array, at: Array, twist: Array) -> tuple[Array, int]:
        out = np.empty(6)
        points = self._renderer.render_into(np.ascontiguousarray(R), at, out, twist)
        return out, max(points, 0)
