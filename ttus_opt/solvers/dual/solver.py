"""The minimiser of Σ (L p - b)²/ω + ‖D p + E c - t‖² through its dual.

The dual is solved by preconditioned conjugate gradients (`conjugate_gradients`,
`preconditioner`); iterative refinement removes the error of inexact products. The
bounds of parameters c beside the field are handled by block pivoting.
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.laplace.system import RTOL
from ttus_opt.solvers.base import is_late
from ttus_opt.solvers.conjugate_gradients import RecycledSubspace
from ttus_opt.solvers.dual import options
from ttus_opt.solvers.dual.linear_parameters import Complement, LinearParameters
from ttus_opt.solvers.dual.preconditioner import SchurPreconditioner
from ttus_opt.solvers.dual.system import DualSystem

#: Largest relative residual of a solve inside a product, over that of a rough dual [–]
PRODUCT = 1e-2

#: Most solves with the same parameters at the same bounds [–]
TWICE = 2


@dataclass(frozen=True)
class Accuracy:
    """Accuracy and deadline of a dual solve.

    Attributes:
        rtol: Residual of the dual, relative to t - D p₀ [–].
        field_rtol: Relative residual of the solves for the answer's field [–].
        deadline: `time.perf_counter` at which to stop [s]; None for never.
    """

    rtol: float
    field_rtol: float = RTOL
    deadline: float | None = None

    @property
    def late(self) -> bool:
        """Whether the deadline has passed."""
        return is_late(self.deadline)


class BlockPivoting:
    """Block principal pivoting: all wrong signs change sides at once.

    For a linear complementarity problem with a positive definite matrix that takes few
    exchanges, but may cycle; where the number of wrong signs does not fall, the last
    one alone changes, which cannot (Murty's rule; Júdice and Pires, Comput. Oper. Res.
    21, 1994).

    Attributes:
        best: The set with the fewest wrong signs so far; None at first.
    """

    def __init__(self, tries: int = 0) -> None:
        """Start.

        Args:
            tries: Exchanges of all wrong signs allowed without fewer of them [–].
        """
        self.best: Mask | None = None
        self._tries = self._left = tries
        self._fewest = sys.maxsize

    def following(self, active: Mask, wrong: Mask) -> Mask | None:
        """The next set after one and its wrong signs; None without any."""
        count = int(np.count_nonzero(wrong))
        if count < self._fewest:
            self.best, self._fewest, self._left = active, count, self._tries
        elif self._left:
            self._left -= 1
        else:
            wrong = np.arange(len(wrong)) == np.flatnonzero(wrong)[-1]
        return active ^ wrong if count else None


@dataclass(frozen=True)
class DualAnswer:
    """Result of one solve.

    Attributes:
        p: The minimiser, shape (V,).
        c: The parameters beside it, shape (k,).
        steps: Number of new directions [–].
        late: Whether the deadline ended the solve.
        y: Multipliers of the rows, shape (m,).
    """

    p: Array = field(repr=False)
    c: Array
    steps: int
    late: bool
    y: Array = field(repr=False)


class DualSolver:
    """One dual system, its recycled subspace and its preconditioner.

    Attributes:
        system: The system.
        parameters: The parameters beside its field.
    """

    def __init__(
        self,
        system: DualSystem,
        parameters: LinearParameters | None = None,
    ) -> None:
        """Load a problem; nothing is solved yet.

        Args:
            system: The dual of the field alone.
            parameters: The parameters beside it; None for none.
        """
        self.system = system
        self.parameters = parameters or LinearParameters.none(len(system.root_weights))
        self._base: tuple[Array, float, Array] | None = None
        self._forget()

    def _forget(self) -> None:
        """Start with an empty subspace, orthogonal to all columns."""
        k = len(self.parameters.lower)
        self._subspace = RecycledSubspace(self.system)
        self._across = np.ones(k, dtype=bool)
        self._free = self.parameters.moving
        self._schur = SchurPreconditioner(self.system)
        self._complement: tuple[bytes, Complement] | None = None

    def adopt(self, system: DualSystem, parameters: LinearParameters) -> None:
        """Change to a system with other weights of the same rows, without a solve.

        Args:
            system: The same rows with other weights.
            parameters: The parameters beside its field; if their columns differ, the
                subspace is lost.
        """
        ratio = system.root_weights / self.system.root_weights
        old, self.system, self.parameters = self.parameters, system, parameters
        same = old.columns.shape == parameters.columns.shape and np.allclose(
            parameters.columns, ratio[:, None] * old.columns, rtol=1e-12, atol=0.0
        )
        if not same:
            self._forget()
        elif not (ratio == 1.0).all():
            self._subspace.adopt(system)
            self._schur = SchurPreconditioner(system)
            self._complement = None

    def solve(
        self, b: Array, t: Array, accuracy: Accuracy, near: Array | None = None
    ) -> DualAnswer:
        """Solve for one right-hand side.

        Args:
            b: Right-hand side of L p = b, shape (V,).
            t: Weighted targets, shape (m,).
            accuracy: Accuracy and deadline.
            near: A guess of c, shape (k,): parameters at a bound start there. None to
                start with the parameters that were free last.

        Returns:
            The answer, whose accuracy the caller verifies.
        """
        parameters, E = self.parameters, self.parameters.columns
        base = self._prior_field(b, accuracy.field_rtol)
        goal = accuracy.rtol * float(np.linalg.norm(t - self.system.measure(base)))
        at = start = DualAnswer(base, np.zeros(0), 0, False, np.zeros_like(t))
        c = parameters.clipped(np.zeros(E.shape[1]) if near is None else near)
        free = self._free if near is None else parameters.between(c)
        pivoting, solved = BlockPivoting(), Counter[bytes]()
        while True:
            given, complement = np.where(free, 0.0, c), self._complement_of(free)
            at, rest = self._refined(at, t - E @ given, complement, goal, accuracy)
            c = given.copy()
            c[free] = complement.coefficients(rest)
            violating = parameters.violating(c, at.y, free)
            c = parameters.clipped(c)
            following = pivoting.following(free, violating)
            solved[free.tobytes() + given.tobytes()] += 1
            if (
                following is None
                or accuracy.late
                # solves that are too rough for Murty's rule
                or solved[following.tobytes() + np.where(following, 0.0, c).tobytes()]
                == TWICE
            ):
                self._free = free
                return replace(at, c=c, late=accuracy.late)
            if (following & ~free).any():  # y must be orthogonal to more columns
                at = replace(start, steps=at.steps)
            free = following

    def _refined(
        self,
        at: DualAnswer,
        target: Array,
        complement: Complement,
        goal: float,
        accuracy: Accuracy,
    ) -> tuple[DualAnswer, Array]:
        """Multipliers refined from a point, and their residual, shape (m,)."""
        system, before = self.system, np.inf
        loosest = max(options.LOOSEST_PRODUCT, PRODUCT * accuracy.rtol)
        residual = target - system.measure(at.p) - at.y
        for _ in range(options.REFINEMENTS):
            rest = complement.part(residual)
            size = float(np.linalg.norm(rest))
            if size <= goal or size >= before:
                break
            before = size
            run = complement.solve(
                self._subspace,
                rest,
                lambda y: goal,
                options.MAX_DIRECTIONS,
                lambda size: min(max(0.1 * goal / size, RTOL), loosest),
                lambda: accuracy.late,
            )
            # p is updated by the step: if measurements contradict each other y is
            # large, and its rounding error would dominate a p computed from all of it
            p = at.p + system.response(run.y, accuracy.field_rtol)
            at = replace(at, p=p, y=at.y + run.y, steps=at.steps + run.steps)
            residual = target - system.measure(p) - at.y
            if accuracy.late:
                break
        return at, residual

    def _complement_of(self, free: Mask) -> Complement:
        """The complement of the free columns, in which the subspace lies too."""
        if (free & ~self._across).any():
            self._subspace = RecycledSubspace(self.system)
            self._across = free
        self._across = self._across & free
        key = free.tobytes()
        if self._complement is None or self._complement[0] != key:
            columns = self.parameters.columns[:, free]
            self._complement = key, Complement(columns, self._schur)
        return self._complement[1]

    def _prior_field(self, b: Array, rtol: float) -> Array:
        """p₀ = L⁻¹b, reused for the same b and no higher accuracy."""
        kept = self._base
        if kept is None or rtol < kept[1] or not np.array_equal(kept[0], b):
            kept = self._base = b, rtol, self.system.laplace.solve(b, rtol=rtol)
        return kept[2]
