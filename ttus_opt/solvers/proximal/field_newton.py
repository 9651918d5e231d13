"""Newton steps with any sparse rows: conjugate gradients, and what precondition them.

The matrix is H = Σ MᵀC M over all rows, C their slopes. What approximates it depends on
the rows: L⁻¹L⁻ᵀ where Laplace's squares dominate, one solve with the block A where
differences of neighbours do (A is their graph's Laplacian but for the volume of a
voxel, `ttus_opt.laplace.system`), the diagonal where rows touch single voxels, and for
small problems a factor of H itself. Which one is found by trying each on the first
system; it is tried again where steps become many.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from ttus_opt.arrays import Array, Mask
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.problem.program import Program
from ttus_opt.solvers.proximal.penalised_rows import PenalisedRows
from ttus_opt.terms.penalties.base import Slope

_Map = Callable[[Array], Array]

#: Up to how many variables H is formed and factorised
SMALL = 3000

#: Most steps of conjugate gradients, and those after which preconditioners are compared
MOST_STEPS, TRIAL_STEPS = 500, 12

#: Steps after which preconditioners are compared again
MANY = 60

#: Relative residual of the solves inside a preconditioner [–]
ROUGHLY = 1e-2


@dataclass
class _Run:
    """Conjugate gradients under way."""

    d: Array
    left: float
    steps: int


class FieldNewton:
    """Newton steps by preconditioned conjugate gradients over all variables."""

    def __init__(
        self, program: Program, blocks: Sequence[PenalisedRows], fixed: Mask
    ) -> None:
        """Take the rows.

        Args:
            program: Whose variables they are over.
            blocks: All rows.
            fixed: Variables whose values are given, shape (n,).
        """
        self._program, self._blocks, self._fixed = program, blocks, fixed
        self._adjoints = [sp.csr_array(rows.matrix.T) for rows in blocks]
        self._squared = [
            rows.matrix.multiply(rows.matrix).tocsr().T.tocsr() for rows in blocks
        ]
        self._chosen: str | None = None

    def step(
        self,
        gradient: Array,
        slopes: Sequence[Slope],
        rtol: float,
        deadline: float | None,
    ) -> tuple[Array, int]:
        """As `LaplaceNewton.step`."""
        side = np.where(self._fixed, 0.0, -gradient)
        if len(side) <= SMALL:
            return self._factorised(side, slopes), 1

        def product(v: Array) -> Array:
            return self._product(v, slopes)

        run = None
        if self._chosen is None:
            self._chosen = self._compare(product, side, slopes)
        precondition = self._preconditioner(self._chosen, slopes)
        run = _conjugate_gradients(product, side, precondition, rtol, deadline)
        if run.steps > MANY:
            self._chosen = None
        return run.d, run.steps

    def _compare(self, product: _Map, side: Array, slopes: Sequence[Slope]) -> str:
        """The preconditioner that reduces a residual most per second."""
        best, fastest = "diagonal", 0.0
        for name in self._names():
            clock = time.process_time()
            precondition = self._preconditioner(name, slopes)
            run = _conjugate_gradients(
                product, side, precondition, 1e-3, None, TRIAL_STEPS
            )
            spent = time.process_time() - clock
            rate = -np.log(max(run.left, 1e-12)) / max(spent, 1e-9)
            if rate > fastest:
                best, fastest = name, rate
        return best

    def _names(self) -> list[str]:
        laplace = self._program.laplace
        if laplace is None or not laplace.is_plain:
            return ["diagonal"]
        return ["diagonal", "differences", "laplace"]

    def _product(self, v: Array, slopes: Sequence[Slope]) -> Array:
        """H v on the variables that are free."""
        out = np.zeros_like(v)
        for rows, adjoint, slope in zip(
            self._blocks, self._adjoints, slopes, strict=True
        ):
            out += adjoint @ slope.times(rows.matrix @ v)
        return np.where(self._fixed, 0.0, out)

    def diagonal(self, slopes: Sequence[Slope]) -> Array:
        """The diagonal of H, without what slopes take off along groups, shape (n,)."""
        out = np.zeros(len(self._fixed))
        for square, slope in zip(self._squared, slopes, strict=True):
            out += square @ slope.factor
        return out

    def _factorised(self, side: Array, slopes: Sequence[Slope]) -> Array:
        """The step of a small problem."""
        free = np.flatnonzero(~self._fixed)
        H = sp.csr_array((len(side),) * 2)
        for rows, adjoint, slope in zip(
            self._blocks, self._adjoints, slopes, strict=True
        ):
            H = H + adjoint @ _matrix(slope) @ rows.matrix
        own = sp.csc_array(H[free][:, free])
        tiny = np.finfo(float).eps * float(abs(own.diagonal()).max(initial=0.0))
        own = own + sp.csc_array(sp.eye_array(len(free)) * tiny)
        d = np.zeros_like(side)
        d[free] = splu(own).solve(side[free])
        return d

    def _preconditioner(self, name: str, slopes: Sequence[Slope]) -> _Map:
        diagonal = self.diagonal(slopes)
        inverse = 1.0 / np.where(diagonal > 0.0, diagonal, 1.0)
        inverse[self._fixed] = 0.0
        laplace = self._program.laplace
        if name == "diagonal" or laplace is None:
            return lambda v: inverse * v
        V = len(laplace.free)
        fields = [
            part
            for part in self._program.variables.values()
            if part.stop - part.start == V
        ]
        own = _like_differences if name == "differences" else _like_laplace
        maps = [own(laplace, inverse[part], self._fixed[part]) for part in fields]

        def precondition(v: Array) -> Array:
            z = inverse * v
            for part, apply in zip(fields, maps, strict=True):
                z[part] = apply(v[part])
            return z

        return precondition


def _like_differences(laplace: LaplaceSystem, inverse: Array, fixed: Mask) -> _Map:
    """A⁻¹ between roots of the radii, at the size of H's diagonal."""
    free = laplace.free & ~fixed
    root = np.where(free, np.sqrt(laplace.radii), 0.0)
    diagonal = -laplace.L.diagonal()
    size = float(np.median((diagonal * inverse)[free]))

    def apply(v: Array) -> Array:
        solved = laplace.multigrid.solve(root * v, rtol=ROUGHLY).x
        return np.where(free, size * root * solved, inverse * v)

    return apply


def _like_laplace(laplace: LaplaceSystem, inverse: Array, fixed: Mask) -> _Map:
    """L⁻¹L⁻ᵀ at the size of H's diagonal."""
    diagonal = laplace.L.diagonal() ** 2
    size = float(np.median((diagonal * inverse)[laplace.free & ~fixed]))

    def apply(v: Array) -> Array:
        u = laplace.solve_adjoint(np.where(fixed, 0.0, v), rtol=ROUGHLY**2)
        u = np.where(fixed, 0.0, size * u)
        return laplace.solve(u, rtol=ROUGHLY**2)

    return apply


def _conjugate_gradients(
    product: _Map,
    side: Array,
    precondition: _Map,
    rtol: float,
    deadline: float | None,
    most: int = MOST_STEPS,
) -> _Run:
    """Flexible conjugate gradients (Notay 2000): preconditioners need not be linear."""
    d, rest = np.zeros_like(side), side.copy()
    first = now = float(np.linalg.norm(side))
    z = precondition(rest)
    direction, steps = z, 0
    energy = float(rest @ z)
    while now > rtol * first and steps < most:
        if deadline is not None and time.perf_counter() > deadline:
            break
        image = product(direction)
        curvature = float(direction @ image)
        if not curvature > 0.0:
            break
        alpha = energy / curvature
        d += alpha * direction
        before, rest = rest, rest - alpha * image
        now = float(np.linalg.norm(rest))
        z = precondition(rest)
        beta = float(z @ (rest - before)) / energy
        energy = float(rest @ z)
        if not energy > 0.0:
            break
        direction = z + max(beta, 0.0) * direction
        steps += 1
    return _Run(d, now / first if first else 0.0, steps)


def _matrix(slope: Slope) -> sp.csr_array:
    """A slope as a matrix, shape (m, m)."""
    factor = sp.csr_array(sp.diags_array(slope.factor))
    if slope.along is None:
        return factor
    groups = len(slope.along) // slope.size
    unit = sp.csr_array(
        (
            np.sqrt(slope.factor) * slope.along,
            np.repeat(np.arange(groups), slope.size),
            np.arange(len(slope.along) + 1),
        ),
        shape=(len(slope.along), groups),
    )
    return sp.csr_array(factor - unit @ unit.T)
