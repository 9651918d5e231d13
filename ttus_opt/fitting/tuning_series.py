"""The measured series of a formulation, on a coarse grid for tuning.

The evidence depends on the field's covariance at the contacts. On a grid with a third
of the voxels or fewer this has nearly the same shape; its scale on both grids is
estimated by a few random probes.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp

from ttus_opt.arrays import Array
from ttus_opt.contact.places import places
from ttus_opt.errors import InputError, TtusWarning
from ttus_opt.fitting.marginal_likelihood import MeasuredSeries
from ttus_opt.fitting.weight_criteria import presses
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.problem.program import Program
from ttus_opt.scene import BOUNDARY_SCALE, Scene, ScenePlan
from ttus_opt.solvers.dual.data import DualData, laplace_prior
from ttus_opt.solvers.dual.system import DualSystem
from ttus_opt.solvers.dual.weight_sweep import WeightSweep

#: About the most voxels of a grid for tuning. On a coarse grid errors of discretisation
#: count as noise: with 16,000 voxels the bundled example on 345,600 gets weights less
#: than half as large, which err 4 % more on unseen motion, in half the time
MOST_VOXELS = 60_000

#: Random probes of the rows' variance, and the relative residual of their solves
PROBES, PROBE_RTOL = 8, 1e-4

#: Relative residual of the solves behind the basis: with a hundredth of it the log
#: evidence differs by less than 0.001 [–]
FIELD_RTOL = 1e-4

#: Most frames in the evidence [–]
MOST_FRAMES = 200

#: Trace of their covariance, in units of the noise, that the basis may miss; the error
#: of the log evidence is at most half of it [–]
MISSING = 2.0

#: Relative difference up to which rows count as affine in a searched parameter [–]
AFFINE = 1e-8


@dataclass(frozen=True)
class TuningRows:
    """The dual of a formulation whose rows may be affine in one coefficient.

    Attributes:
        declared: The formulation.
        terms: Names of the measured terms, three rows per frame each.
        coefficient: Name of the coefficient; empty without one.
        highest: Its largest value.
        system: Rows of weight 1, followed by those that the coefficient multiplies.
        b: Right side of L p = b, shape (V,).
        target: Targets of the rows, shape (rows,) [N].
    """

    declared: Formulation
    terms: tuple[str, ...]
    coefficient: str
    highest: float
    system: DualSystem = field(repr=False)
    b: Array = field(repr=False)
    target: Array = field(repr=False)

    @classmethod
    def of(cls, declared: Formulation) -> TuningRows:
        """Read a formulation; a coefficient that no pose tells is neutral.

        Raises:
            InputError: Its prior is not Laplace's, or its rows are of another kind.
        """
        search, coefficient, highest = declared.search, "", 0.0
        if search is not None and search.parameter != BOUNDARY_SCALE:
            if search.parameter in declared.not_identifiable():
                low = search.neutral_value
            else:
                coefficient, highest, low = search.parameter, search.high, search.low
            declared = search.build(low).named(declared.name)
        program, measured = _compiled(declared)
        data = DualData.of(program, measured)
        system, target = data.system, data.t
        if coefficient:
            assert search is not None
            slope = _slope(search.build, search.low, search.high, system.rows)
            system = replace(
                system,
                rows=sp.csr_array(sp.vstack([system.rows, slope], format="csr")),
                root_weights=np.ones(2 * len(target)),
            )
            target = np.concatenate([target, np.zeros(len(target))])
        names = tuple(term.name for term in measured)
        return cls(declared, names, coefficient, highest, system, data.b, target)

    @property
    def n_rows(self) -> int:
        """Rows of one term [–]."""
        return 3 * len(self.declared.scene.trajectory)

    def include(self, other: TuningRows) -> bool:
        """Whether these are another's rows, at a coefficient of 0 if they have one."""
        if other.coefficient:
            return other is self
        own, n = self.system, len(other.target)
        same = (
            self.terms == other.terms
            and own.laplace is other.system.laplace
            and np.array_equal(own.compliance, other.system.compliance)
            and np.array_equal(self.b, other.b)
            and np.array_equal(self.target[:n], other.target)
        )
        return same and not abs(own.rows[:n] - other.system.rows).sum()

    def variance(self) -> float:
        """Mean prior variance of the first term's rows in contact, with σ² = 1."""
        rng, n = np.random.default_rng(0), self.n_rows
        touching = np.repeat(self.declared.scene.rows.contact_points > 0, 3)
        adjoint, total = self.system.rows[:n].T, 0.0
        for _ in range(PROBES):
            load = adjoint @ (touching * rng.choice([-1.0, 1.0], n))
            slope = self.system.laplace.solve_adjoint(load, rtol=PROBE_RTOL)
            total += float(self.system.compliance @ slope**2)
        return total / PROBES / int(touching.sum())

    def series(self, weight: float) -> MeasuredSeries:
        """The rows in contact, over a basis for weights λ up to ``weight`` [–]."""
        zero = np.zeros((len(self.target), 0))
        data = DualData(self.system, self.b, self.target, zero)
        none = np.zeros(0, dtype=np.int64)  # no fields are asked for
        sweep = WeightSweep(data, field_rtol=FIELD_RTOL, voxels=none)
        scene = self.declared.scene
        touching = scene.rows.contact_points > 0
        every = -(-int(touching.sum()) // MOST_FRAMES)
        sweep.complete(np.full(len(self.target), np.sqrt(weight)), every * MISSING)
        parts = 2 if self.coefficient else 1
        images = np.zeros((len(sweep), len(self.target)))
        images[:, sweep.informative] = sweep.images
        base = np.zeros(len(self.target))
        base[sweep.informative] = self.target[sweep.informative] - sweep.misfit
        shape = (parts, len(self.terms), len(touching), 3)

        def parted(values: Array) -> Array:
            return values.reshape(*values.shape[:-1], *shape)[..., touching, :]

        K, u, t = parted(images), parted(base), parted(self.target)
        press, position = presses(scene)[touching], scene.trajectory.position[touching]
        return MeasuredSeries(
            self.terms,
            K[:, 0],
            u[0],
            t[0],
            scene.trajectory.time[touching],
            press,
            places(press, position, scene.shell.rms_radius),
            (K[:, 1], u[1]) if parts == 2 else None,
        )


def coarse_shape(shape: tuple[int, ...], most: int = MOST_VOXELS) -> tuple[int, ...]:
    """The shape of a grid of about ``most`` voxels; the same where it has no more."""
    share = (most / math.prod(shape)) ** (1.0 / 3.0)
    if share >= 1.0:
        return shape
    return tuple(2 * max(round(share * n / 2), 4) for n in shape)


def coarser(scene: Scene, most: int | None = None) -> Scene:
    """The scene on about ``most`` voxels (`MOST_VOXELS`); itself where it has no more.

    A fitted boundary scale is fitted again, as the coarse surface lies elsewhere.
    """
    shape = coarse_shape(scene.voxmap.grid.shape, most or MOST_VOXELS)
    if shape == scene.voxmap.grid.shape:
        return scene
    fitted = BOUNDARY_SCALE in scene.parameters
    ratio = scene.outer / scene.inner if fitted else scene.outer
    plan = ScenePlan(
        shape,
        scene.voxmap.grid.r_inner,
        scene.voxmap.grid.r_outer,
        "fit" if fitted else scene.inner,
        ratio,
        scene.sampling,
        scene.voxmap.boundary,
        scene.voxmap.grid.sector,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TtusWarning)  # the scene itself has warned
        return plan.build(scene.voxmap.surface, scene.shell, scene.trajectory)


def _compiled(declared: Formulation) -> tuple[Program, list[ProgramTerm]]:
    """The program with weights 1, and its measured terms.

    Raises:
        InputError: The formulation cannot be tuned.
    """
    if not any(term.measures for term in declared.terms):
        raise InputError(
            f"{declared.name} cannot be tuned: it takes no measurements and has no "
            "weights"
        )
    names = [t.name for t in declared.terms if t.measures and len(t.assembled.target)]
    program = declared.with_weights(**dict.fromkeys(names, 1.0)).compile()
    frames = len(declared.scene.trajectory)
    measured = [term for term in program.terms if term.name in names]
    usual = (
        names
        and program.is_quadratic
        and laplace_prior(program) is not None
        and program.n_variables == len(program.laplace.free)
        and all(len(term.target) == 3 * frames for term in measured)
        and sum(len(term.target) > 0 for term in program.terms) == len(names) + 1
    )
    if not usual:
        raise InputError(
            f"{declared.name} cannot be tuned: it needs a Laplace term, squares of "
            "measured rows, three per frame, and no other unknowns; choose its weights "
            "by ttus-opt path with recordings held out"
        )
    return program, measured


def _slope(
    build: Callable[[float], Formulation], low: float, high: float, rows: sp.csr_array
) -> sp.csr_array:
    """Measured rows that a searched parameter multiplies.

    Raises:
        InputError: The rows are not affine in it.
    """

    def at(value: float) -> sp.csr_array:
        _, measured = _compiled(build(value))
        return sp.csr_array(sp.vstack([t.matrix for t in measured], format="csr"))

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
