"""The potential fields of this package as comparators, one per formulation.

Grid, sampling and boundary scale are the package's defaults; the wrench is that of
`ttus_opt.Renderer`, compiled.

Source of `laplace_only` and `eq10`: R. Yeung, D. Black, S. E. Salcudean, Measurement
and Potential Field-Based Patient Modeling for Model-Mediated Tele-ultrasound (2025),
eqs. 8 and 10. Its boundary value is chosen by hand; here it fits the measured forces
best, and λ = 1 suits the trilinear sampling and hard torsos. The others are in
docs/method/formulations.md, Depth map and friction.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Unpack

import numpy as np

from ttus_opt.comparators.base import Comparator, Given
from ttus_opt.contact.scene import Scene, ScenePlan
from ttus_opt.core.arrays import Array
from ttus_opt.fitting.batch import fit
from ttus_opt.fitting.weights.weight_choice import choice_of
from ttus_opt.haptic.renderer import Renderer
from ttus_opt.probe.trajectory import Trajectory

if TYPE_CHECKING:
    from ttus_opt.problem.solution import Solution


class FieldModel(Comparator):
    """A fitted potential field.

    Attributes:
        formulation: Its name.
        defaults: Options of the formulation.
        plan: Grid and sampling.
        solution: The solution, after `fit`.
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
        """Parameters identified with the field."""
        return {} if self.solution is None else dict(self.solution.parameters)

    def _fit(self, recording: Trajectory, force: Array) -> None:
        scene = self.plan.build(self.surface, self.shell, recording)
        self.solution = self._solved(scene)
        # the whole wrench is compared
        self._renderer = Renderer(
            self.solution.field,
            self.shell,
            force_limit=math.inf,
            torque_limit=math.inf,
        )

    def _solved(self, scene: Scene) -> Solution:
        """The fit of the formulation."""
        return fit(scene, self.formulation, **self.defaults)

    def _wrench(self, R: Array, at: Array, twist: Array) -> tuple[Array, int]:
        out = np.empty(6)
        points = self._renderer.render_into(np.ascontiguousarray(R), at, out, twist)
        return out, max(points, 0)


class LaplaceOnly(FieldModel):
    """The Laplace field before any measurement, with one boundary value."""

    name = "laplace_only"
    summary = "Laplace's field scaled to the forces (Yeung and others 2025, eq. 8)"
    formulation = "laplace_only"


class Eq10(FieldModel):
    """The Laplace field corrected by measured forces and torques."""

    name = "eq10"
    summary = "ours: eq. 10, Laplace and measured wrenches, λ = 1 (Yeung 2025)"
    formulation = "eq10"
    defaults: ClassVar = {"force_weight": 1.0, "torque_weight": 1.0}


class Tuned(FieldModel):
    """Eq. 10, with weights as ``ttus-opt fit --formulation eq10`` chooses them."""

    name = "tuned"
    summary = "ours: eq. 10, weights by places left out"
    turns = False  # its searches end within a tolerance

    def _solved(self, scene: Scene) -> Solution:
        choice = choice_of("auto", scene, "eq10", strict=False)
        return fit(choice.scene, choice.formulation)


class DepthMap(FieldModel):
    """One curve of the depth times a Gaussian field over the patient, by evidence."""

    name = "depth_map"
    summary = "ours: depth profile times a Gaussian field, by evidence"
    formulation = "depth_map"


class DepthMapCoulomb(FieldModel):
    """A depth map with one friction coefficient."""

    name = "depth_map_coulomb"
    summary = "ours: depth map with Coulomb drag, by evidence"
    formulation = "depth_map_coulomb"
