"""How sure a fitted field is of the wrenches that it renders, and of itself.

A quadratic fit is the mean of a Gaussian: prior p ~ N(p₀, σ² L⁻¹Ω L⁻ᵀ), measured rows D
of weights W² with noise of variance σ² W⁻². So any rows N of a field have the posterior
covariance

    Cov[N p] = σ² (N C Nᵀ - N C Dᵀ(W⁻² + D C Dᵀ)⁻¹ D C Nᵀ),    C = L⁻¹Ω L⁻ᵀ

(Rasmussen and Williams, 2006, eq. 2.24). N C Nᵀ takes one solve with Lᵀ per row. The
rest is known by a reduced basis (`solvers.dual.weight_sweep`): fields ψᵢ, orthonormal
in the prior's energy, whose coefficients have the prior N(0, 1) and, with B their
weighted images, the posterior covariance (1 + BBᵀ)⁻¹.

Where solves per row cost too much, the covariance is that of fields drawn from the
posterior (Matheron's rule: A. G. Journel, C. J. Huijbregts, Mining Geostatistics,
1978): a draw of the prior, corrected by what its own noisy measurements say of it.

Limits are left out: the doubt is that of the Gaussian without them. σ² is such that
95 % of the measured components lie within 1.96 standard deviations of what the field of
all other presses predicts; with one press, the likeliest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from numpy.typing import NDArray

from ttus_opt.arrays import Array, IntArray, Mask
from ttus_opt.contact.friction import (
    DRAG_AT_REFERENCE,
    DRAG_AXIS,
    DRAG_DEADBAND,
    FRICTION,
    Sliding,
    coulomb_rows,
)
from ttus_opt.contact.rows import contact_rows
from ttus_opt.errors import InputError
from ttus_opt.fitting.weight_criteria import presses
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.problem.solution import Solution
from ttus_opt.scene import BOUNDARY_SCALE, Scene
from ttus_opt.solvers.dual.data import DualData, laplace_prior, root_weights
from ttus_opt.solvers.dual.system import DualSystem
from ttus_opt.solvers.dual.weight_sweep import WeightSweep

Method = Literal["exact", "samples"]

Single = NDArray[np.float32]

#: Largest grid whose rows are solved for one by one [voxels]
MOST_VOXELS = 60_000

#: Draws of the posterior where they are not: standard deviations to 4 % [–]
DRAWS = 256

#: Trace of the covariance, in units of the noise, that the basis may miss: what is
#: missed counts as unknown [–]
MISSING = 0.2

#: Relative residual of the solves [–]
RTOL = 1e-6

#: Prior standard deviation of a fitted boundary scale, over the field's σ: the data
#: alone tell it [–]
SCALE_DEVIATION = 1e3

#: Share of measured components within `NORMAL` standard deviations, of a normal
#: distribution [–]
COVERED, NORMAL = 0.95, 1.959964


@dataclass(frozen=True)
class WrenchDoubt:
    """Posterior covariance of rendered wrenches.

    Attributes:
        covariance: Of force [N] and torque [N·m] of every frame, shape (T, 6, 6).
        force_noise: Standard deviation of what a measured force component shows beside
            the field [N].
        torque_noise: The same of a torque component; NaN without [N·m].
    """

    covariance: Array = field(repr=False)
    force_noise: float
    torque_noise: float

    @property
    def force(self) -> Array:
        """Standard deviation of the force's components, shape (T, 3) [N]."""
        return np.asarray(np.sqrt(np.einsum("tii->ti", self.covariance)[:, :3]))

    @property
    def torque(self) -> Array:
        """Standard deviation of the torque's components, shape (T, 3) [N·m]."""
        return np.asarray(np.sqrt(np.einsum("tii->ti", self.covariance)[:, 3:]))

    @property
    def force_size(self) -> Array:
        """Standard deviation of the whole force, √ trace, shape (T,) [N]."""
        return np.asarray(np.sqrt((self.force**2).sum(axis=1)))


@dataclass(frozen=True)
class Doubt:
    """The posterior of one fit.

    Attributes:
        scene: Patient, probe and measurements.
        variance: σ², of a row of weight 1 [N²].
        method: Whether rows are solved for, or drawn fields are rendered.
        calibrated_by: ``presses left out``, or ``likelihood`` where there is one press.
    """

    scene: Scene = field(repr=False)
    variance: float
    method: Method
    calibrated_by: str
    _posterior: _Posterior = field(repr=False)
    _draws: Single | None = field(repr=False)
    _parameters: Mapping[str, float] = field(repr=False)
    _noise: tuple[float, float] = field(repr=False)

    def std(self, trajectory: Trajectory) -> WrenchDoubt:
        """How sure the field is of what it renders along a trajectory.

        Args:
            trajectory: Poses; with drag their motion counts.
        """
        rows = _wrench_rows(self.scene, trajectory, self._parameters)
        return WrenchDoubt(self.covariance(rows, 6), *self._noise)

    def covariance(self, rows: sp.csr_array, height: int = 1) -> Array:
        """Posterior covariance of consecutive rows of a field.

        Args:
            rows: N, shape (k · height, V).
            height: Rows of a block [–].

        Returns:
            The blocks, shape (k, height, height).

        Raises:
            InputError: Another number of voxels, or rows that are no whole blocks.
        """
        if rows.shape[1] != self.scene.n_voxels or rows.shape[0] % height:
            raise InputError(
                f"rows must be (k · {height}, {self.scene.n_voxels}), got {rows.shape}"
            )
        if self._draws is None:
            blocks = self._posterior.covariance(rows, height)
        else:
            values = np.asarray(rows @ self._draws.T).reshape(-1, height, DRAWS)
            blocks = values @ values.transpose(0, 2, 1) / DRAWS
        return self.variance * blocks

    def potential_std(self) -> Array:
        """Standard deviation of the field, shape (n_r, n_θ, n_z) [of the field].

        By draws, whatever the method.
        """
        draws = self._draws
        if draws is None:
            draws = self._posterior.draw(DRAWS)
        std = np.sqrt(self.variance * np.mean(draws.astype(np.float64) ** 2, axis=0))
        return np.asarray(self.scene.voxmap.grid.unflatten(std))


def doubt(solution: Solution, scene: Scene, *, method: Method | None = None) -> Doubt:
    """The posterior behind a solution.

    Args:
        solution: Of one field: a Laplace term and squares of measured rows.
        scene: Which it was fitted to.
        method: "exact" solves for every rendered row, "samples" draws `DRAWS` fields
            once; None takes the former on up to 60,000 voxels.

    Raises:
        InputError: The problem has another prior or other unknowns, the scene is
            another, or nothing was measured.
    """
    program = solution.program
    V = scene.n_voxels
    usual = laplace_prior(program) is not None and program.n_variables == V
    if not (usual and program.is_quadratic):
        raise InputError(
            f"no doubt of {solution.formulation}: it needs one field, a Laplace term "
            "and squares of measured rows"
        )
    if program.laplace is not scene.laplace:
        raise InputError("the solution is of another scene: give the one it is of")
    measured = [t for t in program.terms if t.weight > 0.0 and not t.laplace_rows]
    frames = len(scene.trajectory)
    if not measured or any(len(t.target) != 3 * frames for t in measured):
        raise InputError(
            "doubt needs measured terms with three rows per frame: fit eq10 or another "
            "formulation with measured forces"
        )
    data = DualData.of(program)
    scale = BOUNDARY_SCALE in solution.parameters and BOUNDARY_SCALE not in (
        solution.not_identified
    )
    posterior = _Posterior.of(data, root_weights(program), scale)
    frame = np.concatenate([np.repeat(np.arange(frames), 3)] * len(measured))
    press = presses(scene)[frame[posterior.told]]
    variance, how = posterior.scale_of(press)
    method = method or ("exact" if V <= MOST_VOXELS else "samples")
    draws = posterior.draw(DRAWS) if method == "samples" else None
    weights = {term.name: term.weight for term in measured}
    noise = {name: float(np.sqrt(variance / w)) for name, w in weights.items()}
    if "torque" in noise:  # rows of torque are over a length
        own = next(t.target for t in measured if t.name == "torque")
        noise["torque"] *= float(np.linalg.norm(scene.tau) / np.linalg.norm(own))
    return Doubt(
        scene,
        variance,
        method,
        how,
        posterior,
        draws,
        dict(solution.parameters),
        (noise.get("force", np.nan), noise.get("torque", np.nan)),
    )


@dataclass(frozen=True)
class _Posterior:
    """The Gaussian of a problem, with σ² = 1.

    Attributes:
        system: Its dual.
        told: Rows that say something of the field, shape (m,).
        misfit: What these measured beyond p₀, times their weights' roots, (rows,).
        fields: ψ, shape (k, V); the last one is p₀ where its scale is unknown.
        weighted: B, shape (k, rows).
        inner: (1 + BBᵀ)⁻¹, shape (k, k).
        n_prior: Fields that are not p₀.
    """

    system: DualSystem
    told: Mask
    misfit: Array
    fields: Array
    weighted: Array
    inner: Array
    n_prior: int

    @classmethod
    def of(cls, data: DualData, root: Array, scale: bool) -> _Posterior:
        sweep = WeightSweep(data, field_rtol=RTOL)
        sweep.complete(root, MISSING)
        fields, images, n = sweep.fields, sweep.images, len(sweep)
        own = root[sweep.told]
        if scale:
            base = SCALE_DEVIATION * sweep.base
            image = np.asarray(data.system.rows[sweep.told] @ base)
            fields = np.concatenate([fields, base[None]])
            images = np.concatenate([images, image[None]])
        B = images * own
        gram = B @ B.T
        gram[np.diag_indices_from(gram)] += 1.0
        inner = scipy.linalg.inv(gram)
        return cls(data.system, sweep.told, own * sweep.misfit, fields, B, inner, n)

    def covariance(self, rows: sp.csr_array, height: int) -> Array:
        """Of blocks of rows, by a solve for each row that has an entry."""
        laplace, root = self.system.laplace, np.sqrt(self.system.compliance)
        known = np.asarray(rows @ self.fields.T)
        out = np.zeros((rows.shape[0] // height, height, height))
        told = np.diff(rows.indptr).reshape(-1, height) > 0
        for k in np.flatnonzero(told.any(axis=1)).tolist():
            block = slice(k * height, (k + 1) * height)
            loads = rows[block].toarray()
            slopes = np.stack(
                [root * laplace.solve_adjoint(load, rtol=RTOL) for load in loads]
            )
            a = known[block]
            rest = slopes @ slopes.T - a[:, : self.n_prior] @ a[:, : self.n_prior].T
            out[k] = rest + a @ self.inner @ a.T
        return out

    def draw(self, count: int) -> Single:
        """Draws of the field around its mean, shape (count, V)."""
        rng, laplace = np.random.default_rng(0), self.system.laplace
        root, V = np.sqrt(self.system.compliance), self.fields.shape[1]
        rows = self.system.rows[self.told]
        weights = self.system.root_weights[self.told]
        out = np.empty((count, V), dtype=np.float32)
        for k in range(count):
            p = laplace.solve(root * rng.standard_normal(V), rtol=RTOL)
            if len(self.fields) > self.n_prior:
                p += rng.standard_normal() * self.fields[-1]
            said = weights * (rows @ p) + rng.standard_normal(len(weights))
            out[k] = p - (self.inner @ (self.weighted @ said)) @ self.fields
        return out

    def scale_of(self, press: IntArray) -> tuple[float, str]:
        """σ², and what it is estimated by.

        Args:
            press: Which press a row belongs to, shape (rows,) [–].
        """
        half = np.linalg.cholesky(self.inner).T @ self.weighted
        rest = self.misfit - half.T @ (half @ self.misfit)
        numbers = np.unique(press)
        if len(numbers) < 2:
            return float(rest @ self.misfit) / len(rest), "likelihood"
        scores = np.empty_like(rest)
        for number in numbers:
            at = np.flatnonzero(press == number)
            X = half[:, at]
            left = np.eye(len(X)) - X @ X.T
            solved = scipy.linalg.solve(left, X, assume_a="pos")
            error = rest[at] + X.T @ (solved @ rest[at])
            scores[at] = error / np.sqrt(1.0 + np.einsum("ki,ki->i", X, solved))
        deviation = float(np.quantile(np.abs(scores), COVERED)) / NORMAL
        return deviation**2, "presses left out"


def _wrench_rows(
    scene: Scene, trajectory: Trajectory, parameters: Mapping[str, float]
) -> sp.csr_array:
    """Force and torque rows of every frame, six of a frame together, (6T, V)."""
    rows = contact_rows(
        scene.voxmap,
        scene.shell,
        trajectory.rotation,
        trajectory.position,
        sampling=scene.sampling,
    )
    N, W = rows.N, rows.W
    mu = parameters.get(FRICTION, 0.0)
    if mu:
        at = "reference" if parameters.get(DRAG_AT_REFERENCE) else "contact"
        axis = np.array([parameters[name] for name in DRAG_AXIS])
        sliding = Sliding.of(scene.voxmap, scene.shell, trajectory, at, axis)
        drag = coulomb_rows(sliding, rows, deadband=parameters[DRAG_DEADBAND])
        N, W = N - mu * drag.force, W - mu * drag.torque
    both = sp.csr_array(sp.vstack([N, W], format="csr"))
    T = len(trajectory)
    frame, part = np.divmod(np.arange(6 * T), 6)
    order = np.where(part < 3, 3 * frame + part, 3 * T + 3 * frame + part - 3)
    return sp.csr_array(both[order])
