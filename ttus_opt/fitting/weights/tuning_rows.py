"""The measured rows of a formulation over a reduced basis of its prior.

With C the covariance of the prior at the measured rows D, KᵀK ≈ C. Of a Laplace prior,
K comes from response fields (`ttus_opt.solvers.dual.weight_sweep`), of any other sum of
squares from a sparse factor of its Hessian. Unknowns beside the field are known to
nothing but the measurements: they have a very wide prior.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg

from ttus_opt.contact.scene import BOUNDARY_SCALE, Scene
from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.errors import InputError
from ttus_opt.fitting.uncertainty.contact_spread import pressed_places
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.problem.program import Program
from ttus_opt.solvers.dual.data import DualData
from ttus_opt.solvers.dual.weight_sweep import WeightSweep

#: Most frames whose rows are used; each then stands for several [–]
MOST_FRAMES = 300

#: Most unknowns of a prior that is factorised: a minute [–]
MOST_UNKNOWNS = 60_000

#: Relative residual of the solves behind the basis, and the trace of the rows'
#: covariance that it may miss, in units of their noise
FIELD_RTOL, MISSING = 1e-4, 2.0

#: Random probes of the rows' variance, and the relative residual of their solves
PROBES, PROBE_RTOL = 8, 1e-4

#: Prior deviation of unknowns beside the field, over what the rows measure [–]
WIDE = 1e3

#: Most unknowns beside the field
MOST_BESIDE = 20

#: Relative difference up to which rows count as affine in a searched parameter [–]
AFFINE = 1e-8

#: Parts of a term whose rows belong to no frames, each left out as a place [–]
PARTS = 10


@dataclass(frozen=True)
class BasisRows:
    """Measured rows over a basis, m in all.

    Attributes:
        images: K, shape (k, m).
        base: What the prior's mean measures, shape (m,).
        target: Measurements, shape (m,).
        term: Number of every row's term, shape (m,) [–].
        place: Number of every row's place, shape (m,) [–].
        every: Number of rows that each stands for, shape (m,) [–].
        slope: Images and base of the part that a coefficient multiplies; None without.
    """

    images: Array = field(repr=False)
    base: Array = field(repr=False)
    target: Array = field(repr=False)
    term: IntArray = field(repr=False)
    place: IntArray = field(repr=False)
    every: Array = field(repr=False)
    slope: tuple[Array, Array] | None = field(default=None, repr=False)

    def at(self, coefficient: float) -> BasisRows:
        """The rows at a value of their coefficient."""
        if self.slope is None:
            return self
        images, base = (coefficient * part for part in self.slope)
        return replace(
            self, images=self.images + images, base=self.base + base, slope=None
        )


@dataclass(frozen=True)
class TuningRows:
    """The compiled measurements of a formulation, with weight 1.

    Attributes:
        declared: The formulation; of a searched coefficient, at its lowest value.
        terms: Names of the measured terms.
        coefficient: Name of the searched coefficient; empty without one.
        highest: Its largest value.
        program: The program.
        measured: Its measured terms.
        chosen: Rows that are used, of all measured terms, shape (m,).
        term: As in `BasisRows`.
        place: As in `BasisRows`.
        every: As in `BasisRows`.
        slope: Rows that the coefficient multiplies, (m, n); None without one.
    """

    declared: Formulation
    terms: tuple[str, ...]
    coefficient: str
    highest: float
    program: Program = field(repr=False)
    measured: tuple[ProgramTerm, ...] = field(repr=False)
    chosen: IntArray = field(repr=False)
    term: IntArray = field(repr=False)
    place: IntArray = field(repr=False)
    every: Array = field(repr=False)
    slope: sp.csr_array | None = field(default=None, repr=False)

    @classmethod
    def of(cls, declared: Formulation) -> TuningRows:
        """Read a formulation; a coefficient that no pose tells is neutral.

        Raises:
            InputError: It has no measured rows, or is no sum of squares.
        """
        search, coefficient, highest = declared.search, "", 0.0
        if search is not None and search.parameter != BOUNDARY_SCALE:
            if search.parameter in declared.not_identifiable():
                low = search.neutral_value
            else:
                coefficient, highest, low = search.parameter, search.high, search.low
            declared = search.build(low).named(declared.name)
        program, measured = _compiled(declared)
        slope = None
        if coefficient:
            assert search is not None
            slope = _slope(search.build, search.low, search.high, _stack(measured))
        parts, start = [], 0
        for k, term in enumerate(measured):
            rows, places, each = _split(declared.scene, term)
            parts.append(np.broadcast_arrays(start + rows, k, places, each))
            start += len(term.target)
        chosen, number, place, every = np.concatenate(parts, axis=1)
        # rows without an entry do not depend on the field
        told = np.diff(_stack(measured)[chosen].indptr) > 0
        return cls(
            declared,
            tuple(t.name for t in measured),
            coefficient,
            highest,
            program,
            tuple(measured),
            chosen[told],
            number[told],
            place[told],
            every[told].astype(np.float64),
            None if slope is None else sp.csr_array(slope[chosen[told]]),
        )

    @property
    def is_laplace(self) -> bool:
        """Whether a Laplace term alone is the prior."""
        return _is_laplace(self.program, self.terms)

    @property
    def matrix(self) -> sp.csr_array:
        """The rows, at a coefficient of its lowest value, shape (m, n)."""
        return sp.csr_array(_stack(self.measured)[self.chosen])

    @property
    def target(self) -> Array:
        """Measurements, shape (m,)."""
        return np.concatenate([t.target for t in self.measured])[self.chosen]

    def variance(self) -> float:
        """Mean prior variance of the first term's rows."""
        first = self.term == 0
        if not self.is_laplace:
            images = self._factorised(sp.csr_array(self.matrix[first]))[0]
            return float((images**2).sum() / first.sum())
        system, rng, total = self._dual().system, np.random.default_rng(0), 0.0
        adjoint = system.rows[: len(first)][first].T
        for _ in range(PROBES):
            load = adjoint @ rng.choice([-1.0, 1.0], int(first.sum()))
            total += system.field_prior.within(PROBE_RTOL).square(load)
        return total / PROBES / int(first.sum())

    def over_basis(self, largest: float) -> BasisRows:
        """The rows over a basis for weights λ up to ``largest`` [–]."""
        if not self.is_laplace:
            rows = self.matrix
            if self.slope is not None:
                rows = sp.csr_array(sp.vstack([rows, self.slope]))
            images, base = self._factorised(rows)
        else:
            images, base = self._swept(largest)
        m = len(self.term)
        slope = None if self.slope is None else (images[:, m:], base[m:])
        return BasisRows(
            images[:, :m],
            base[:m],
            self.target,
            self.term,
            self.place,
            self.every,
            slope,
        )

    def _dual(self) -> DualData:
        """The dual of these rows, the coefficient's below, without other unknowns."""
        data = DualData.of(self.program, list(self.measured))
        V = len(data.b)
        rows = self.matrix[:, :V]
        if self.slope is not None:
            rows = sp.vstack([rows, self.slope[:, :V]])
        rows = sp.csr_array(rows)
        system = replace(data.system, rows=rows, root_weights=np.ones(rows.shape[0]))
        target = np.zeros(rows.shape[0])
        target[: len(self.term)] = self.target
        return DualData(system, data.b, target, np.zeros((len(target), 0)))

    def _swept(self, largest: float) -> tuple[Array, Array]:
        """Images and base for a Laplace prior."""
        data = self._dual()
        none = np.zeros(0, dtype=np.int64)  # no fields are asked for
        sweep = WeightSweep(data, field_rtol=FIELD_RTOL, voxels=none)
        every = np.resize(self.every, len(data.t))
        sweep.complete(np.sqrt(largest * every), MISSING)
        beside = self._beside
        images = np.zeros((len(sweep) + len(beside), len(data.t)))
        images[: len(sweep), sweep.informative] = sweep.images
        images[len(sweep) :, : len(self.term)] = beside
        base = np.zeros(len(data.t))
        base[sweep.informative] = data.t[sweep.informative] - sweep.misfit
        return images, base

    @property
    def _beside(self) -> Array:
        """Columns of the unknowns beside the field, shape (columns, m)."""
        V = len(self.program.laplace.free)
        columns = self.matrix[:, V:].toarray().T
        size = np.linalg.norm(columns, axis=1, keepdims=True)
        wide = WIDE * float(np.linalg.norm(self.target))
        return np.asarray(wide * columns / np.where(size > 0.0, size, 1.0))

    def _factorised(self, rows: sp.csr_array) -> tuple[Array, Array]:
        """Images and base of rows for a prior of any squares, by a sparse factor."""
        names = {t.name for t in self.measured}
        terms = tuple(t for t in self.program.terms if t.name not in names)
        Q, d = replace(self.program, terms=terms).normal_equations()
        diagonal = np.full(Q.shape[0], 1e-12 * float(Q.diagonal().max(initial=0.0)))
        given = self.program.dirichlet
        if given is not None:
            fixed = np.asarray(abs(given.matrix).sum(axis=0)).ravel() > 0.0
            hard = 1e9 * float(Q.diagonal().max(initial=1.0))
            diagonal[fixed] += hard
            d = d + hard * (given.matrix.T @ given.lower)
        try:
            factor = scipy.sparse.linalg.splu(
                sp.csc_matrix(Q + sp.diags_array(diagonal)), permc_spec="MMD_AT_PLUS_A"
            )
        except RuntimeError:
            raise InputError(
                f"{self.declared.name} cannot be tuned: its terms that measure nothing "
                "leave part of the field open; add a prior to it"
            ) from None
        half = factor.solve(rows.T.toarray())
        values, turn = np.linalg.eigh(np.asarray(rows @ half))
        kept = values > 1e-12 * values[-1]
        images = (turn[:, kept] * np.sqrt(values[kept])).T
        return images, np.asarray(rows @ factor.solve(d))


def _split(scene: Scene, term: ProgramTerm) -> tuple[IntArray, IntArray, int]:
    """Rows of a term that are used, their places, and how many each stands for."""
    n, T = len(term.target), len(scene.trajectory)
    if n % T:  # rows of no frames
        rows = np.arange(n)
        place = -1 - rows * PARTS // n
        step = -(-n // (3 * MOST_FRAMES))
        return rows[::step], place[::step], step
    height, touching = n // T, scene.touching
    told = np.diff(term.matrix.indptr).reshape(T, height).any(axis=1)
    # drag has rows in the air too, where there is nothing to predict
    frames = np.flatnonzero(told & touching if (told & touching).any() else told)
    step = max(-(-len(frames) // MOST_FRAMES), 1)
    frames = frames[::step]
    rows = (height * frames[:, None] + np.arange(height)).ravel()
    return rows, np.repeat(pressed_places(scene)[frames], height), step


def _compiled(declared: Formulation) -> tuple[Program, list[ProgramTerm]]:
    """The program with weights 1, and its measured terms.

    Raises:
        InputError: The formulation cannot be tuned.
    """
    if not any(term.measures for term in declared.terms):
        raise _untunable(declared, "it takes no measurements and has no weights")
    names = [t.name for t in declared.terms if t.measures and len(t.assembled.target)]
    if not names:
        raise _untunable(declared, "its measured terms have no rows")
    program = declared.with_weights(**dict.fromkeys(names, 1.0)).compile()
    why = _obstacle(program, names)
    if why:
        raise _untunable(declared, why)
    return program, [term for term in program.terms if term.name in names]


def _obstacle(program: Program, measured: Collection[str]) -> str:
    """Why a program with these measured terms has no closed form; else empty."""
    for term in program.terms:
        if not term.penalty.quadratic:
            return f"its term {term.name} is no sum of squares"
        if term.known_covariance is not None:
            return f"its {term.name} chooses the noise by itself"
    if program.cones:
        return f"{program.cones[0].name} is a second-order cone"
    others = program.n_variables - len(program.laplace.free)
    if others > MOST_BESIDE:
        return f"it has {others:,} unknowns beside the field"
    if _is_laplace(program, measured):
        return ""
    if all(t.name in measured for t in program.terms if len(t.target)):
        return "it has no term that says what a field is like"
    if program.n_variables > MOST_UNKNOWNS:
        return (
            f"its prior is not Laplace's alone and has {program.n_variables:,} "
            f"unknowns, {MOST_UNKNOWNS:,} are possible: choose a coarser grid"
        )
    return ""


def _is_laplace(program: Program, measured: Collection[str]) -> bool:
    """Whether the only term with rows that are not measured is a Laplace term."""
    others = [t for t in program.terms if t.name not in measured and len(t.target)]
    return len(others) == 1 and others[0] is program.laplace_prior


def _untunable(declared: Formulation, why: str) -> InputError:
    return InputError(
        f"{declared.name} cannot be tuned: {why}; give weights, or compare some on "
        "recordings held out by ttus-opt path"
    )


def _stack(measured: list[ProgramTerm] | tuple[ProgramTerm, ...]) -> sp.csr_array:
    return sp.csr_array(sp.vstack([t.matrix for t in measured], format="csr"))


def _slope(
    build: Callable[[float], Formulation], low: float, high: float, rows: sp.csr_array
) -> sp.csr_array:
    """Measured rows that a searched parameter multiplies.

    Raises:
        InputError: The rows are not affine in it.
    """

    def at(value: float) -> sp.csr_array:
        return _stack(_compiled(build(value))[1])

    slope = (at(high) - rows) / (high - low)
    middle = 0.5 * (low + high)
    expected = rows + (middle - low) * slope
    if abs(at(middle) - expected).max() > AFFINE * abs(expected).max():
        raise InputError(
            "a formulation that searches for a number can be tuned only if its "
            "measured rows are affine in that number: choose its weights by ttus-opt "
            "path"
        )
    return sp.csr_array(slope)
