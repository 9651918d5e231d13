"""Estimate of a depth map's profile and hyperparameters by marginal likelihood.

With the field p = c (d/d₀)ᵃ (1 + g), the measured normal forces uᵀf are Gaussian,

    uᵀf ~ N(c G, c² G-weighted covariance of g + Σ),   G = uᵀN (d/d₀)ᵃ,

where u is the direction of contact (`part_noise`). Their log density, the evidence, is
maximised over the exponent a, the relative deviation σ of g, its correlation lengths
along the surface and along the depth, the noise s² = σ_0² + (ρ c G)² of a frame and a
tracker's error δ of depth, which lasts a second; c follows by least squares. Weak
log-normal priors keep poorly determined values near those measured on soft tissue.

Frames of a press a few millimetres apart share what the model has wrong there. Without
that covariance in Σ, their errors would be attributed to tissue that varies over a few
millimetres. It is in the evidence only: what is wrong at a place is so at the next
visit, and the fit is to learn it. A tracker's error is not, and has its covariance in
the fit. The noise grows with the force of the mean, not with the measured one: forces
that happen to be large would count less, and every estimate would be too soft.

Source: C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning
(2006), section 5.4.1. See docs/method/formulations.md, Depth map.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np
import scipy.optimize
import scipy.sparse as sp
from scipy.spatial.distance import cdist

from ttus_opt.contact.contact_size import patch_factors
from ttus_opt.contact.rows import diagonal_blocks
from ttus_opt.contact.scene import Scene
from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.errors import InputError
from ttus_opt.gaussian.conditioned import ByCovariance
from ttus_opt.gaussian.matern import matern
from ttus_opt.gaussian.posterior_mode import posterior_mode
from ttus_opt.problem.terms.depth_profile import (
    EXPONENTS,
    DepthProfile,
    check_depth_map,
    depth_map_limits,
    powers_of,
    slopes_of,
    voxel_depths,
)
from ttus_opt.problem.terms.depth_regression import expected_errors
from ttus_opt.problem.terms.part_noise import (
    RELATIVE,
    SENSOR,
    TURN,
    PartNoise,
    contact_directions,
    lasting,
)
from ttus_opt.voxmap.grid import CylindricalGrid
from ttus_opt.voxmap.sampling import least_length

#: Median and logarithmic standard deviation of the priors. The length along the surface
#: is in units of the probe's root-mean-square radius: what varies over less, a probe
#: hardly tells, and who examines finer structures takes a finer probe. So is the length
#: ℓ₀ of `contact-size`, up to which a patch is as on a thin layer, which forces tell of
#: well. The relative noise is in addition to `RELATIVE`, which the model has wrong:
#: forces without noise look as if it were exact, and would teach what they cannot
PRIOR = {
    "exponent": (1.3, 0.2),
    "surface_length": (2.6, 0.2),
    "deviation": (0.4, 0.7),
    "depth_length": (0.01, 0.5),
    "sensor_noise": (SENSOR, 1.0),
    "relative_noise": (RELATIVE, 1.0),
    "length_ratio": (1.0, 0.5),
    "shared_error": (0.03, 0.7),
    "depth_error": (1e-4, 1.0),
    "least_length": (0.5, 1.0),
}

#: What the model has wrong however exact the sensor, by name in `PRIOR` [N], [–]
LEAST = {"sensor_noise": SENSOR, "relative_noise": RELATIVE}

#: Those in units of the probe's radius
IN_RADII = {"surface_length", "least_length"}

#: Most evaluations of the evidence
CALLS = 400

#: Most frames in the evidence, whose cost grows with their number cubed [–]
MOST_FRAMES = 300

#: Most nodes on the surface between which the variation is interpolated [–]
MOST_NODES = 300

#: At least one force must be as large [N]
LEAST_FORCE = 0.1

#: Distance over which frames of a press share an error [m]
SHARED_DISTANCE = 0.005

#: Smallest noise over the forces, so that the covariance can be factorised [–]
LEAST_NOISE = 1e-4

#: Covariances kept while differences change one value after the other [–]
KEPT = 4

#: Depths between which the correlation along the depth is interpolated, and its
#: smallest eigenvalue over the largest [–]
DEPTHS, LEAST_EIGENVALUE = 40, 1e-3


class UnusableForcesError(InputError):
    """Forces that no depth profile explains."""


@dataclass(frozen=True)
class Hyperparameters:
    """What the evidence chooses, in the order of `PRIOR`.

    Attributes:
        exponent: a [–].
        surface_length: ℓ [m].
        deviation: σ [–].
        depth_length: Length along the depth [m].
        sensor_noise: σ_0 of a normal force [N].
        relative_noise: ρ [–].
        length_ratio: Length around the patient over length along it, of which ℓ is the
            geometric mean [–].
        shared_error: η, relative error that neighbouring frames of a press share [–].
        depth_error: δ, error of the depth of a pose, which lasts a second [m].
        least_length: ℓ₀ of `contact-size`, for which all of this is [m]; 0 as the scene
            samples.
    """

    exponent: float
    surface_length: float = 0.03
    deviation: float = 0.4
    depth_length: float = 0.01
    sensor_noise: float = SENSOR
    relative_noise: float = RELATIVE
    length_ratio: float = 1.0
    shared_error: float = 0.03
    depth_error: float = 0.0
    least_length: float = 0.0


@dataclass(frozen=True, kw_only=True)
class DepthMapEstimate(Hyperparameters):
    """The most likely profile and hyperparameters.

    Attributes:
        profile: φ.
        noise: Root mean square over the frames of the error of a normal force [N].
        log_evidence: Log evidence plus log prior, up to a constant [–].
    """

    profile: DepthProfile
    noise: float
    log_evidence: float

    def part_noise(self, scene: Scene, turn: float = TURN) -> PartNoise:
        """Relative errors of the parts of a scene's wrenches, by the direction's."""
        depth = np.maximum(voxel_depths(scene.voxmap), 0.0)
        normal = diagonal_blocks(contact_directions(scene)[:, None]) @ scene.N
        force = normal @ self.profile(depth)
        slope = slopes_of(depth, self.profile.exponents) @ self.profile.coefficients
        alone = np.hypot(self.sensor_noise, self.relative_noise * force)
        per_depth = normal @ slope
        noise = PartNoise.of(scene, alone, force, self.depth_error * per_depth, turn)
        return replace(noise, lost=per_depth * expected_errors(scene, self.depth_error))


def estimate_depth_map(
    scene: Scene,
    rows: sp.csr_array | None = None,
    *,
    force: Array | None = None,
    errors: Callable[[IntArray], Array] | None = None,
    resampled: bool = False,
    **given: float | None,
) -> DepthMapEstimate:
    """Estimate profile, deviation, lengths and noise.

    Args:
        scene: A scene with measured forces.
        rows: Force rows, (3T, V); by default the scene's N (with drag: N − μ F).
        force: Forces to take instead of the scene's, shape (3T,) [N].
        errors: Covariance of the forces' errors by wrong poses for k frames, given
            their numbers, (3k, 3k) [N²]; by default none.
        resampled: Whether ℓ₀ is estimated, instead of as the scene samples.
        given: Values that are not estimated, lengths in m, by their names in `PRIOR`;
            None where there is none.

    Raises:
        InputError: A value outside its range (`depth_map_limits`).
        UnusableForcesError: No force was measured in contact, or the forces pull.
    """
    check_depth_map(scene.voxmap.grid, **given)
    rows = scene.N if rows is None else rows
    problem = _Problem.of(scene, rows, force, errors)
    held = {name: value for name, value in given.items() if value is not None}
    if not resampled:
        held["least_length"] = 0.0
    names = [name for name in PRIOR if name not in held]
    medians = np.log([PRIOR[name][0] for name in names])
    widths = np.array([PRIOR[name][1] for name in names])

    limits = depth_map_limits(scene.voxmap.grid)

    def chosen(steps: Array) -> Hyperparameters:
        values = dict(zip(names, np.exp(medians + widths * steps), strict=True))
        for name in IN_RADII & values.keys():
            values[name] *= scene.shell.rms_radius
        for name in LEAST.keys() & values.keys():
            values[name] = np.hypot(LEAST[name], values[name])
        for name in limits.keys() & values.keys():
            values[name] = np.clip(values[name], *limits[name])
        return Hyperparameters(**held, **{name: float(v) for name, v in values.items()})

    mode = posterior_mode(
        lambda steps: problem.evidence(chosen(steps)), len(names), CALLS
    )
    likeliest = chosen(mode.steps)
    c, mean = problem.mean(likeliest)
    return DepthMapEstimate(
        **vars(likeliest),
        profile=DepthProfile((likeliest.exponent,), (c,)),
        noise=float(np.sqrt(problem.variances(likeliest, mean).mean())),
        log_evidence=mode.log_posterior,
    )


def least_squares_profile(scene: Scene) -> DepthProfile:
    """The profile that alone explains the measured forces best, for equal noise.

    It takes milliseconds; what the evidence changes is in docs/method, Depth map.

    Args:
        scene: A scene with measured forces.

    Raises:
        UnusableForcesError: No force was measured in contact, or the forces pull.
    """
    chosen = (3 * _frames(scene, scene.f)[:, None] + np.arange(3)).ravel()
    depth = np.maximum(voxel_depths(scene.voxmap), 0.0)
    design = scene.N[chosen] @ powers_of(depth, EXPONENTS)
    coefficients, _ = scipy.optimize.nnls(design, scene.f[chosen])
    if not coefficients.any():
        raise UnusableForcesError(PULLING)
    return DepthProfile(EXPONENTS, tuple(float(c) for c in coefficients))


PULLING = (
    "the measured forces pull the probe in instead of pushing it out: give the force "
    "ON the probe in patient axes"
)


def neighbours(scene: Scene, frames: IntArray) -> Array:
    """Correlation of the errors that k frames share within a press, shape (k, k)."""
    press, at = scene.presses[frames], scene.trajectory.position[frames]
    same = press[:, None] == press
    return np.asarray(matern(cdist(at, at), SHARED_DISTANCE) * same)


def _frames(scene: Scene, force: Array) -> IntArray:
    """Frames in contact.

    Raises:
        UnusableForcesError: There is none, or none with a force that counts.
    """
    size = np.linalg.norm(force.reshape(-1, 3), axis=1)
    frames = np.flatnonzero(scene.touching)
    if not scene.N.nnz:  # light presses reach no voxel of voxel-mean
        raise UnusableForcesError(
            "a depth profile needs forces measured in contact, but the probe never "
            f"touches the patient, or too lightly for {scene.sampling} on this grid: "
            "check the trajectory's frame, or fit laplace_only"
        )
    if size[frames].max() <= LEAST_FORCE:
        raise UnusableForcesError(
            "a depth profile needs forces measured in contact, but where the probe "
            f"touches they reach {size[frames].max():.2g} N only: check the "
            "sensor and the trajectory's frame, or fit laplace_only"
        )
    return frames


@dataclass(frozen=True)
class _Problem:
    """Measured normal forces and the voxels that they touch.

    Attributes:
        rows: Rows of normal forces over the touched voxels, shape (m, n).
        force: Measured normal forces, shape (m,) [N].
        spread: Of the patches, shape (m,) [m²].
        sampled: Factors of the patches in the rows, shape (m,) [–].
        depth: Depths of the touched voxels, shape (n,) [m].
        spoke: Index of every voxel's spoke among the k touched ones, shape (n,).
        nodes: Interpolation on these spokes from fewer nodes, shape (k, nodes).
        around: Distances of the nodes around the patient, (nodes, nodes) [m].
        along: The same along it [m].
        alike: Correlation of the errors that frames share, shape (m, m) [–].
        late: Correlation of a tracker's errors, shape (m, m) [–].
        further: Covariance of further errors, shape (m, m) or () [N²].
    """

    rows: sp.csr_array = field(repr=False)
    force: Array = field(repr=False)
    spread: Array = field(repr=False)
    sampled: Array = field(repr=False)
    depth: Array = field(repr=False)
    spoke: IntArray = field(repr=False)
    nodes: sp.csr_array = field(repr=False)
    around: Array = field(repr=False)
    along: Array = field(repr=False)
    alike: Array = field(repr=False)
    late: Array = field(repr=False)
    further: Array = field(repr=False)

    @classmethod
    def of(
        cls,
        scene: Scene,
        rows: sp.csr_array,
        force: Array | None = None,
        errors: Callable[[IntArray], Array] | None = None,
    ) -> _Problem:
        """Frames in contact, thinned evenly.

        Raises:
            UnusableForcesError: No force was measured in contact, or the forces pull.
        """
        force = scene.f if force is None else force
        frames = _frames(scene, force)
        frames = frames[:: -(-len(frames) // MOST_FRAMES)]
        normal = diagonal_blocks(contact_directions(scene)[frames, None])
        chosen = (3 * frames[:, None] + np.arange(3)).ravel()
        pressed = sp.csr_array(normal @ rows[chosen])
        touched = np.unique(pressed.indices).astype(np.int64)
        grid, trajectory = scene.voxmap.grid, scene.trajectory
        n_spokes = grid.shape[1] * grid.shape[2]
        spokes, spoke = np.unique(touched % n_spokes, return_inverse=True)
        nodes, weights = _coarser(spokes, grid)
        j, k = np.unravel_index(nodes, grid.shape[1:])
        theta, z = grid.theta[j], grid.z[k]
        radius = scene.voxmap.surface.radius_at(theta, z)
        place = np.stack([radius * np.cos(theta), radius * np.sin(theta)], axis=1)
        time, own_of = trajectory.time[frames], trajectory.segment[frames]
        late = lasting(time[:, None], time) * (own_of[:, None] == own_of)
        further = np.zeros(())
        if errors is not None:
            further = np.asarray(normal @ (normal @ errors(frames)).T)
        spread, least = scene.patches.spread[frames], least_length(scene.sampling)
        sampled = patch_factors(spread, least) if least else np.ones(len(frames))
        problem = cls(
            sp.csr_array(pressed[:, touched]),
            normal @ force[chosen],
            spread,
            sampled,
            np.maximum(voxel_depths(scene.voxmap)[touched], 0.0),
            spoke,
            weights,
            cdist(place, place),
            np.abs(z[:, None] - z),
            neighbours(scene, frames),
            late,
            further,
        )
        if problem.mean(Hyperparameters(PRIOR["exponent"][0]))[0] <= 0.0:
            raise UnusableForcesError(PULLING)
        return problem

    def size(self, chosen: Hyperparameters) -> Array:
        """What ℓ₀ changes of every row, shape (m,) [–]."""
        if not chosen.least_length:
            return np.ones(len(self.force))
        return patch_factors(self.spread, chosen.least_length) / self.sampled

    def mean(self, chosen: Hyperparameters) -> tuple[float, Array]:
        """Its coefficient c by least squares, and its forces c G, shape (m,)."""
        G = self.rows @ powers_of(self.depth, (chosen.exponent,))[:, 0]
        G *= self.size(chosen)
        c = float(G @ self.force) / float(G @ G)
        return c, c * G

    def variances(self, chosen: Hyperparameters, mean: Array) -> Array:
        """Noise variance of every normal force, shape (m,) [N²]."""
        least = LEAST_NOISE**2 * float(np.mean(self.force**2))
        square = chosen.sensor_noise**2 + (chosen.relative_noise * mean) ** 2
        return np.asarray(np.maximum(square, least))

    def covariance(self, chosen: Hyperparameters) -> Array:
        """Covariance of the normal forces for c = 1 and σ = 1, (m, m)."""
        size = self.size(chosen)
        return (
            size[:, None]
            * size
            * self._covariance(
                chosen.exponent,
                chosen.depth_length,
                chosen.surface_length,
                chosen.length_ratio,
            )
        )

    @cached_property
    def _covariance(self) -> Callable[[float, float, float, float], Array]:
        """The same, kept while a search changes the other values."""
        m, nodes = len(self.force), self.nodes

        @lru_cache(maxsize=KEPT)
        def by_node(exponent: float, depth_length: float) -> list[sp.csr_array]:
            power = powers_of(self.depth, (exponent,))
            of_entry = (power * self._modes(depth_length))[self.rows.indices]
            data = (self.rows.data[:, None] * of_entry).T
            n, size = data.shape
            spoke = np.tile(self.spoke[self.rows.indices], n)
            starts = (size * np.arange(n)[:, None] + self.rows.indptr[:-1]).ravel()
            entries = data.ravel(), spoke, np.append(starts, n * size)
            every = sp.csr_array(sp.csr_array(entries, (n * m, nodes.shape[0])) @ nodes)
            return [every[k * m : (k + 1) * m] for k in range(n)]

        @lru_cache(maxsize=KEPT)
        def covariance(
            exponent: float, depth_length: float, surface_length: float, ratio: float
        ) -> Array:
            root = np.sqrt(ratio)
            between = np.hypot(self.around / root, self.along * root)
            among = matern(between, surface_length)
            out = np.zeros((m, m))
            for mode in by_node(exponent, depth_length):
                out += mode @ (mode @ among).T
            return out

        return covariance

    def evidence(self, chosen: Hyperparameters) -> float:
        """Log density of the normal forces, up to a constant."""
        c, mean = self.mean(chosen)
        cov = (c * chosen.deviation) ** 2 * self.covariance(chosen) + self.further
        cov += chosen.shared_error**2 * self.alike * mean[:, None] * mean
        slope = c * (self.rows @ slopes_of(self.depth, (chosen.exponent,))[:, 0])
        slope *= self.size(chosen)
        cov += chosen.depth_error**2 * self.late * slope[:, None] * slope
        cov[np.diag_indices_from(cov)] += self.variances(chosen, mean)
        return ByCovariance.of(cov, self.force - mean).log_density

    def _modes(self, length: float) -> Array:
        """Columns B with B Bᵀ the correlation of the voxels' depths, (n, modes)."""
        at = np.linspace(0.0, max(float(self.depth.max()), length / 100.0), DEPTHS)
        values, vectors = np.linalg.eigh(matern(np.abs(at[:, None] - at), length))
        kept = values > LEAST_EIGENVALUE * values.max()
        roots = vectors[:, kept] * np.sqrt(values[kept])
        return np.stack([np.interp(self.depth, at, root) for root in roots.T], axis=1)


def _coarser(spokes: IntArray, grid: CylindricalGrid) -> tuple[IntArray, sp.csr_array]:
    """Nodes of a grid of spokes, so coarse that few are needed, and bilinear weights.

    Args:
        spokes: Numbers of k spokes.
        grid: The voxels.

    Returns:
        Numbers of the nodes among the spokes, and weights of shape (k, nodes).
    """
    n_theta, n_z = grid.shape[1:]
    end, step = n_theta if grid.wall is None else n_theta - 1, 1
    while True:
        around, along = _between(n_theta, end, step), _between(n_z, n_z - 1, step)
        weights = sp.csr_array(sp.kron(around, along, format="csr")[spokes])
        weights.eliminate_zeros()
        nodes = np.unique(weights.indices).astype(np.int64)
        if len(nodes) <= MOST_NODES:
            return nodes, sp.csr_array(weights[:, nodes])
        step += 1


def _between(n: int, end: int, step: int) -> sp.csr_array:
    """Linear weights of n places in a ring between every step-th, and the end."""
    at = np.arange(n)
    low = at // step * step
    high = np.minimum(low + step, end)
    share = (at - low) / np.maximum(high - low, 1)
    entries = np.concatenate([1.0 - share, share])
    columns = np.concatenate([low, high % n])
    return sp.csr_array((entries, (np.tile(at, 2), columns)), shape=(n, n))
