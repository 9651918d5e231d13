"""The faces of one field with limits, for `exchange`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from ttus_opt.arrays import Array
from ttus_opt.laplace.system import RTOL
from ttus_opt.problem.program import Program
from ttus_opt.solvers.dual.activity import Activity
from ttus_opt.solvers.dual.data import DualData
from ttus_opt.solvers.dual.limits import SpokeLimits
from ttus_opt.solvers.dual.solver import NEARBY, DualAnswer, DualSolver
from ttus_opt.solvers.dual.subproblem import Face, face_of


@dataclass(frozen=True)
class LimitedField:
    """A program of the field alone.

    Attributes:
        program: The problem.
        limits: Its limits.
        data: The dual of its objective alone.
        whole: Solver of that, kept from solve to solve.
    """

    program: Program
    limits: SpokeLimits
    data: DualData
    whole: DualSolver
    links_hold_slopes: ClassVar[bool] = True

    @property
    def shape(self) -> tuple[int, int, int]:
        """Of the grid."""
        return self.limits.shape

    def face(self, active: Activity) -> FieldFace:
        """The problem left when some limits are active."""
        if active.count == 0:
            return FieldFace(Face.whole(self.data), self.whole)
        face = face_of(self.program.laplace, self.limits, active, self.data)
        return FieldFace(face, DualSolver(face.system))

    def objective(self, p: Array) -> float:
        """The objective."""
        return self.program.objective(p)

    def gradient(self, p: Array) -> Array:
        """Gradient of the objective, shape (V,)."""
        return np.add(*self.program.gradient(p))


@dataclass(frozen=True)
class FieldFace:
    """One face and the solver of its dual."""

    face: Face
    solver: DualSolver

    def solve(
        self,
        *,
        rtol: float,
        field_rtol: float = RTOL,
        deadline: float | None,
        guess: Array | None,
    ) -> DualAnswer:
        """The best field on it."""
        face = self.face
        if guess is not None:
            guess = face.unknowns_of(guess) if rtol <= NEARBY else None
        answer = self.solver.solve(
            face.b,
            face.t,
            rtol=rtol,
            deadline=deadline,
            guess=guess,
            field_rtol=field_rtol,
        )
        return replace(answer, p=face.field_of(answer.p))
