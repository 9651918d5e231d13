"""A program: the matrices of a formulation, with named rows.

minimise Σ_k w_k φ_k(M_k x - t_k)  subject to  lower ≤ A x ≤ upper, lb ≤ x ≤ ub

x stacks the variables, the field p first. With squares and linear penalties this is a
quadratic program; `ttus_opt.problem.reduction` makes Huber's penalty and absolute
values such, group norms and cones need a cone solver. In the least-squares form
(`least_squares_qp`) residuals are variables, so that measured rows do not fill in
P = 2 Σ w MᵀM.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from ttus_opt.contact.scene import Scene
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.problem.constraints.base import Bounds, ConeRows, Constraint, LinearRows
from ttus_opt.problem.members import (
    ProgramBounds,
    ProgramCones,
    ProgramConstraint,
    ProgramTerm,
    StackedTerms,
)
from ttus_opt.problem.terms.base import AffineRows, Term
from ttus_opt.problem.terms.penalties import Linear
from ttus_opt.problem.terms.rows import stacked
from ttus_opt.problem.terms.structure import Tag

#: Name and rows of a member
_Named = tuple[str, AffineRows | LinearRows | ConeRows | Bounds]


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
        n_lifted: Number of residuals among the variables, the last ones.
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
        variables: Place of each variable in x, by name.
        terms: Terms of the objective.
        constraints: Linear rows between limits.
        bounds: Bounds.
        laplace: The scene's L, whose structure solvers use.
        cones: Second-order cones.
        declared: The original of a reduced program (`ttus_opt.problem.reduction`), for
            solvers that take its penalties; None where nothing is reduced.
    """

    variables: Mapping[str, slice]
    terms: tuple[ProgramTerm, ...]
    constraints: tuple[ProgramConstraint, ...]
    bounds: tuple[ProgramBounds, ...]
    laplace: LaplaceSystem = field(repr=False)
    cones: tuple[ProgramCones, ...] = ()
    declared: Program | None = field(default=None, repr=False)

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
        stated = tuple(terms)
        held = [(member.name, member.assembled) for member in constraints]
        held += [pair for term in stated for pair in term.requires.items()]
        own = [(term.name, term.assembled) for term in stated]
        sizes = _variable_sizes(scene.n_voxels, [*own, *held])
        n = sum(sizes.values())
        ends = np.cumsum(list(sizes.values())).tolist()
        variables = {
            name: slice(end - size, end)
            for (name, size), end in zip(sizes.items(), ends, strict=True)
        }
        linear: list[ProgramConstraint] = []
        cones: list[ProgramCones] = []
        bounds: list[ProgramBounds] = []
        for name, rows in held:
            if isinstance(rows, Bounds):
                part = variables[rows.variable]
                lower, upper = np.full(n, -np.inf), np.full(n, np.inf)
                lower[part], upper[part] = rows.lower, rows.upper
                bounds.append(ProgramBounds(name, lower, upper, part))
            elif isinstance(rows, ConeRows):
                A = stacked(rows.blocks, sizes, len(rows.offset))
                cones.append(ProgramCones(name, A, rows.offset, rows.sizes))
            else:
                A = stacked(rows.blocks, sizes, len(rows.lower))
                linear.append(
                    ProgramConstraint(name, A, rows.lower, rows.upper, rows.tags)
                )
        return cls(
            variables,
            tuple(
                ProgramTerm(
                    term.name,
                    term.weight,
                    stacked(term.assembled.blocks, sizes, len(term.assembled.target)),
                    term.assembled.target,
                    term.penalty,
                    term.assembled.tags | ({Tag.MEASURED} if term.measures else set()),
                )
                for term in stated
            ),
            tuple(linear),
            tuple(bounds),
            scene.laplace,
            tuple(cones),
        )

    def __repr__(self) -> str:
        """Sizes and names in one line."""
        held = [member.name for member in (*self.limited_rows, *self.bounds)]
        terms = ", ".join(term.name for term in self.terms)
        limits = f" subject to {', '.join(held)}" if held else ""
        return f"<Program over {self.sizes}: {terms}{limits}>"

    @property
    def sizes(self) -> str:
        """The variables and their sizes in words."""
        parts = self.variables.items()
        return in_words({name: part.stop - part.start for name, part in parts})

    @property
    def n_variables(self) -> int:
        """Length n of x [–]."""
        return int(max(part.stop for part in self.variables.values()))

    @property
    def is_quadratic(self) -> bool:
        """Whether it is a quadratic program: squares, linear terms, no cones."""
        return not self.cones and all(t.penalty.quadratic for t in self.terms)

    def split(self, x: Array) -> dict[str, Array]:
        """The variables of x by name."""
        return {name: x[part] for name, part in self.variables.items()}

    @property
    def limited_rows(self) -> tuple[ProgramConstraint | ProgramCones, ...]:
        """All rows with multipliers: linear ones, then cones."""
        return *self.constraints, *self.cones

    @property
    def box(self) -> tuple[Array, Array]:
        """All bounds together, (lb, ub), shape (n,) each; read-only."""
        if not self.bounds:
            n = self.n_variables
            return np.broadcast_to(-np.inf, n), np.broadcast_to(np.inf, n)
        lower = np.full(self.n_variables, -np.inf)
        upper = np.full(self.n_variables, np.inf)
        for bound in self.bounds:
            np.maximum(lower, bound.lower, out=lower)
            np.minimum(upper, bound.upper, out=upper)
        return lower, upper

    def term(self, name: str) -> ProgramTerm | None:
        """The term of that name, if there is one."""
        return next((term for term in self.terms if term.name == name), None)

    def laplace_term_of(self, variable: str) -> ProgramTerm | None:
        """The sum of squares over rows of L of a field, unscaled rows preferred.

        Args:
            variable: The field's name.

        Returns:
            None without one.
        """
        terms = []
        for term in self.terms:
            rows = term.laplace_rows
            if rows is not None and rows.variable == variable and term.is_squares:
                if rows.scale is None:
                    return term
                terms.append(term)
        return terms[0] if terms else None

    @property
    def laplace_prior(self) -> ProgramTerm | None:
        """That of p alone, with L's rows or scaled ones; None without one."""
        term = self.laplace_term_of("p")
        rows = None if term is None else term.laplace_rows
        return None if rows is None or rows.beside else term

    @property
    def known_prior(self) -> ProgramTerm | None:
        """The term over p whose covariance is known, if there is one of a weight."""
        known = (t for t in self.terms if t.known_covariance and t.weight > 0.0)
        return next(known, None)

    @property
    def laplace_term(self) -> ProgramTerm | None:
        """The sum of squares over the rows of the scene's L itself, if there is one."""
        term = self.laplace_term_of("p")
        rows = None if term is None else term.laplace_rows
        plain = rows is not None and rows.scale is None and rows.system is None
        return term if plain else None

    @property
    def dirichlet(self) -> ProgramConstraint | None:
        """The constraint that gives p its Dirichlet values, if there is one."""
        tagged = (c for c in self.constraints if Tag.DIRICHLET in c.tags)
        return next(tagged, None)

    def costs(self, x: Array) -> dict[str, float]:
        """Weighted cost per term."""
        return {term.name: term.cost(x) for term in self.terms}

    def objective(self, x: Array) -> float:
        """Sum of the weighted costs."""
        return sum(self.costs(x).values())

    def gradient(self, x: Array) -> tuple[Array, Array]:
        """Gradient P x + q of a quadratic objective, as its two summands.

        Returns:
            P x and q, shape (n,) each, without forming P.

        Raises:
            InputError: A penalty is neither squares nor linear.
        """
        self._require_quadratic()
        return self.curvature_times(x), self.gradient_at_zero()

    def curvature_times(self, x: Array) -> Array:
        """P x of the squares, shape (n,)."""
        curved = np.zeros(self.n_variables)
        for term in self.terms:
            if term.is_squares and term.weight:
                curved += 2.0 * term.weight * (term.matrix.T @ (term.matrix @ x))
        return curved

    def gradient_at_zero(self) -> Array:
        """The vector q of squares and linear penalties, shape (n,)."""
        linear = self._slope()
        for term in self.terms:
            if term.is_squares:
                linear -= 2.0 * term.weight * (term.matrix.T @ term.target)
        return linear

    def _slope(self) -> Array:
        """Gradient of the linear penalties, shape (n,)."""
        slope = np.zeros(self.n_variables)
        for term in self.terms:
            if isinstance(term.penalty, Linear):
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
            if term.is_squares:
                adjoint = sp.csr_array(term.matrix.T)
                Q = Q + term.weight * (adjoint @ term.matrix)
                d = d + term.weight * (adjoint @ term.target)
        return sp.csc_array(Q), d

    def least_squares_qp(self) -> QuadraticForm:
        """The QP over (x, u) that minimises ½ ‖√2 u‖² with u = √w (M x - t)."""
        self._require_quadratic()
        n = self.n_variables
        squares = StackedTerms.of([t for t in self.terms if t.is_squares], n)
        rows = [squares.weighted, *(c.matrix for c in self.constraints)]
        t, m = squares.root * squares.target, len(squares.target)
        lower, upper = self.limits
        # one format per stacking: scipy converts mixed ones through coordinates
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

    @property
    def limits(self) -> tuple[Array, Array]:
        """Lower and upper limits of all linear rows, shape (m,) each."""
        nothing = np.zeros(0)
        lower = [constraint.lower for constraint in self.constraints]
        upper = [constraint.upper for constraint in self.constraints]
        return np.concatenate([*lower, nothing]), np.concatenate([*upper, nothing])

    def _require_quadratic(self) -> None:
        if not self.is_quadratic:
            others = [t.name for t in self.terms if not t.penalty.quadratic]
            others += [cone.name for cone in self.cones]
            raise InputError(
                f"{', '.join(others)} is not a sum of squares: reduce() the program "
                "first, or choose a cone solver"
            )


def in_words(sizes: Mapping[str, int]) -> str:
    """Variables with their sizes."""
    return ", ".join(f"{name} in R^{size:,}" for name, size in sizes.items())


def _variable_sizes(n_voxels: int, members: Iterable[_Named]) -> dict[str, int]:
    """Number of entries of every variable, the field p first.

    Args:
        n_voxels: V, the entries of p [–].
        members: Names and rows of terms and constraints.

    Raises:
        InputError: Two members give a variable different sizes.
    """
    sizes = {"p": n_voxels}
    for owner, rows in members:
        if isinstance(rows, Bounds):
            given = {rows.variable: len(rows.lower)}
        else:
            given = {name: M.shape[1] for name, M in rows.blocks.items()}
        for name, size in given.items():
            if sizes.setdefault(name, size) != size:
                raise InputError(
                    f"{owner} gives variable {name!r} {size} entries, others "
                    f"{sizes[name]}"
                )
    return sizes
