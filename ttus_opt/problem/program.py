"""A program: the matrices of a formulation, every row still knowing its owner.

minimise Σ_k w_k φ_k(M_k x - t_k)  subject to  lower ≤ A x ≤ upper, lb ≤ x ≤ ub

x stacks the variables, the field p first. Where all penalties are squares or linear
this is a quadratic program (Huber's and absolute ones become such by
`ttus_opt.problem.reduction`; group norms need a cone solver), in two forms: explicit
(`explicit_qp`, P = 2 Σ w MᵀM, which the measured rows fill in) and least-squares
(`least_squares_qp`, the residuals as variables of their own, which stays sparse).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp

from ttus_opt.arrays import Array
from ttus_opt.constraints.base import Bounds, Constraint, LinearRows
from ttus_opt.errors import InputError
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.problem.members import (
    QUADRATIC,
    ProgramBounds,
    ProgramConstraint,
    ProgramTerm,
)
from ttus_opt.scene import Scene
from ttus_opt.terms.base import AffineRows, Penalty, Term
from ttus_opt.terms.laplace import LaplaceTerm


@dataclass(frozen=True)
class QuadraticForm:
    """minimise ½ xᵀP x + qᵀx + constant over lower ≤ A x ≤ upper, lb ≤ x ≤ ub.

    Attributes:
        P: Symmetric positive semidefinite, shape (n, n).
        q: Shape (n,).
        A: Shape (m, n).
        lower: Shape (m,).
        upper: Shape (m,).
        lb: Shape (n,).
        ub: Shape (n,).
        n_lifted: How many of the n variables, the last ones, are residuals.
    """

    P: sp.csc_array = field(repr=False)
    q: Array = field(repr=False)
    A: sp.csc_array = field(repr=False)
    lower: Array = field(repr=False)
    upper: Array = field(repr=False)
    lb: Array = field(repr=False)
    ub: Array = field(repr=False)
    n_lifted: int = 0


@dataclass(frozen=True)
class Program:
    """Matrices with named rows.

    Attributes:
        variables: Where each variable lies in x, by name.
        terms: What is minimised.
        constraints: Linear rows that must hold.
        bounds: Bounds that must hold.
        laplace: The structure of the scene's Laplace term.
    """

    variables: Mapping[str, slice]
    terms: tuple[ProgramTerm, ...]
    constraints: tuple[ProgramConstraint, ...]
    bounds: tuple[ProgramBounds, ...]
    laplace: LaplaceSystem = field(repr=False)

    @classmethod
    def build(
        cls,
        scene: Scene,
        terms: Iterable[Term],
        constraints: Iterable[Constraint],
    ) -> Program:
        """Stack the rows of terms and constraints over their common variables.

        Raises:
            InputError: Two members give a variable different sizes.
        """
        term_rows = [(term, term.assembled) for term in terms]
        constraint_rows = [
            (constraint, constraint.assembled) for constraint in constraints
        ]
        sizes = {"p": scene.n_voxels}
        members: list[tuple[Term | Constraint, AffineRows | LinearRows | Bounds]] = [
            *term_rows,
            *constraint_rows,
        ]
        for member, rows in members:
            if isinstance(rows, Bounds):
                found = {rows.variable: len(rows.lower)}
            else:
                found = {k: M.shape[1] for k, M in rows.blocks.items()}
            for name, size in found.items():
                if sizes.setdefault(name, size) != size:
                    raise InputError(
                        f"{member.name} gives variable {name!r} {size} entries, others "
                        f"{sizes[name]}"
                    )
        variables, start = {}, 0
        for name, size in sizes.items():
            variables[name] = slice(start, start + size)
            start += size
        program_terms = tuple(
            ProgramTerm(
                term.name,
                term.weight,
                _stack(rows.blocks, sizes, len(rows.target)),
                rows.target,
                term.penalty,
                term.threshold,
                term.group_size,
                term.laplace_scale,
            )
            for term, rows in term_rows
        )
        linear, bounds = [], []
        for constraint, given in constraint_rows:
            if isinstance(given, Bounds):
                lower, upper = np.full(start, -np.inf), np.full(start, np.inf)
                part = variables[given.variable]
                lower[part], upper[part] = given.lower, given.upper
                bounds.append(ProgramBounds(constraint.name, lower, upper, part))
            else:
                A = _stack(given.blocks, sizes, len(given.lower))
                linear.append(
                    ProgramConstraint(constraint.name, A, given.lower, given.upper)
                )
        return cls(
            variables, program_terms, tuple(linear), tuple(bounds), scene.laplace
        )

    @property
    def n_variables(self) -> int:
        """Length n of x [–]."""
        return int(max(part.stop for part in self.variables.values()))

    @property
    def is_quadratic(self) -> bool:
        """Whether every penalty is a sum of squares or a plain sum."""
        return all(term.penalty in QUADRATIC for term in self.terms)

    def with_weights(self, **weights: float) -> Program:
        """The same program with other weights by term name; nothing is stacked again.

        Raises:
            InputError: No term has that name.
        """
        unknown = [name for name in weights if self.term(name) is None]
        if unknown:
            raise InputError(
                f"no term {unknown[0]!r}, there are "
                f"{', '.join(t.name for t in self.terms)}"
            )
        terms = (t.with_weight(weights.get(t.name, t.weight)) for t in self.terms)
        return replace(self, terms=tuple(terms))

    def split(self, x: Array) -> dict[str, Array]:
        """The variables of x by name."""
        return {name: x[part] for name, part in self.variables.items()}

    @property
    def is_unconstrained(self) -> bool:
        """Whether nothing but the objective is given."""
        return not (self.constraints or self.bounds)

    @property
    def box(self) -> tuple[Array, Array]:
        """All bounds together, (lb, ub), shape (n,) each."""
        lower = np.full(self.n_variables, -np.inf)
        upper = np.full(self.n_variables, np.inf)
        for bound in self.bounds:
            np.maximum(lower, bound.lower, out=lower)
            np.minimum(upper, bound.upper, out=upper)
        return lower, upper

    def term(self, name: str) -> ProgramTerm | None:
        """The term of that name, if there is one."""
        return next((term for term in self.terms if term.name == name), None)

    @property
    def laplace_term(self) -> ProgramTerm | None:
        """The term whose matrix is the scene's L, if there is one."""
        return self.term(LaplaceTerm.name)

    def costs(self, x: Array) -> dict[str, float]:
        """Weighted cost per term."""
        return {term.name: term.cost(x) for term in self.terms}

    def objective(self, x: Array) -> float:
        """Sum of the weighted costs."""
        return sum(self.costs(x).values())

    def gradient(self, x: Array) -> tuple[Array, Array]:
        """Gradient P x + q of a quadratic objective, as its two summands.

        Returns:
            P x and q, shape (n,) each; neither is formed through P.

        Raises:
            InputError: A penalty is neither squares nor linear.
        """
        self._require_quadratic()
        return self.quadratic_gradient(x)

    def quadratic_gradient(self, x: Array) -> tuple[Array, Array]:
        """`gradient` of those terms that are squares or linear."""
        curved, linear = np.zeros(self.n_variables), self._slope()
        for term in self.terms:
            if term.penalty is Penalty.SQUARES:
                adjoint = term.matrix.T
                curved += 2.0 * term.weight * (adjoint @ (term.matrix @ x))
                linear -= 2.0 * term.weight * (adjoint @ term.target)
        return curved, linear

    def _slope(self) -> Array:
        """Gradient of the linear penalties, shape (n,)."""
        slope = np.zeros(self.n_variables)
        for term in self.terms:
            if term.penalty is Penalty.LINEAR:
                slope += term.weight * (term.matrix.T @ np.ones(len(term.target)))
        return slope

    def normal_equations(self) -> tuple[sp.csc_array, Array]:
        """Q and d of the closed form Q x = d (paper eqs. 11-13).

        Returns:
            Q = Σ w MᵀM of shape (n, n) and d = Σ w Mᵀt of shape (n,); a linear
            term adds -½ w Mᵀ1 to d.

        Raises:
            InputError: A penalty is neither squares nor linear.
        """
        self._require_quadratic()
        n = self.n_variables
        Q, d = sp.csr_array((n, n)), -0.5 * self._slope()
        for term in self.terms:
            if term.penalty is Penalty.SQUARES:
                adjoint = sp.csr_array(term.matrix.T)
                Q = Q + term.weight * (adjoint @ term.matrix)
                d = d + term.weight * (adjoint @ term.target)
        return sp.csc_array(Q), d

    def explicit_qp(self) -> QuadraticForm:
        """The QP with P = 2Q formed."""
        Q, d = self.normal_equations()
        rows = [c.matrix for c in self.constraints]
        A = sp.vstack([*rows, sp.csr_array((0, self.n_variables))], format="csr")
        return QuadraticForm(
            sp.csc_array(2.0 * Q),
            -2.0 * d,
            sp.csc_array(A),
            *self._limits(),
            *self.box,
        )

    def least_squares_qp(self) -> QuadraticForm:
        """The QP over (x, u) with u = √w (M x - t) and ½ ‖√2 u‖² minimised.

        Keeps L and N apart, so that no measured row squares its columns together.
        """
        self._require_quadratic()
        n = self.n_variables
        squares = [t for t in self.terms if t.penalty is Penalty.SQUARES]
        root = [np.sqrt(term.weight) for term in squares]
        blocks = [w * s.matrix for w, s in zip(root, squares, strict=True)]
        rows = [*blocks, *(c.matrix for c in self.constraints), sp.csr_array((0, n))]
        t = np.concatenate(
            [*(w * s.target for w, s in zip(root, squares, strict=True)), np.zeros(0)]
        )
        m = len(t)
        lower, upper = self._limits()
        # one format per stacking: mixed ones take the slow way through coordinates
        left = sp.csc_array(sp.vstack(rows, format="csr"))
        right = sp.csc_array(
            (np.full(m, -1.0), np.arange(m), np.arange(m + 1)),
            shape=(left.shape[0], m),
        )
        lb, ub = self.box
        free = np.full(m, np.inf)
        diagonal = np.concatenate([np.zeros(n), np.full(m, 2.0)])
        return QuadraticForm(
            sp.csc_array(sp.diags_array(diagonal)),
            np.concatenate([self._slope(), np.zeros(m)]),
            sp.csc_array(sp.hstack([left, right], format="csc")),
            np.concatenate([t, lower]),
            np.concatenate([t, upper]),
            np.concatenate([lb, -free]),
            np.concatenate([ub, free]),
            m,
        )

    def _limits(self) -> tuple[Array, Array]:
        """Lower and upper limits of all constraint rows."""
        nothing = np.zeros(0)
        lower = [constraint.lower for constraint in self.constraints]
        upper = [constraint.upper for constraint in self.constraints]
        return np.concatenate([*lower, nothing]), np.concatenate([*upper, nothing])

    def _require_quadratic(self) -> None:
        if not self.is_quadratic:
            bent = [t.name for t in self.terms if t.penalty not in QUADRATIC]
            raise InputError(
                f"{', '.join(bent)} is not a sum of squares: reduce() the program "
                "first, or choose a cone solver"
            )


def _stack(
    blocks: Mapping[str, sp.csr_array], sizes: Mapping[str, int], n_rows: int
) -> sp.csr_array:
    """Blocks side by side in the order of the variables, zero where absent."""
    if len(sizes) == 1:  # no copy in the usual case of p alone
        return blocks["p"]
    parts = [
        blocks.get(name, sp.csr_array((n_rows, size))) for name, size in sizes.items()
    ]
    return sp.csr_array(sp.hstack(parts))
