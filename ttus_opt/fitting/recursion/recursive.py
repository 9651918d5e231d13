"""Eq. 10 one measurement at a time, equal to the batch fit.

This module handles poses, wrenches, the test for outliers and the list of measurements;
the linear algebra is `recursion.dual_recursion`. The test compares a measurement with
the prediction from all earlier ones: with p ~ Normal(p₀, s (LᵀL)⁻¹) and noise
variances s/λ_f and s ℓ²/λ_τ, νᵀS⁻¹ν of the innovation ν is χ² distributed.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field

import numpy as np
from scipy.special import chdtri

from ttus_opt.contact.rows import ContactRows, checked_poses, contact_rows
from ttus_opt.contact.scene import Scene
from ttus_opt.core.arguments import expect_not_negative, expect_positive
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.fitting.recursion.dual_recursion import DualRecursion
from ttus_opt.fitting.recursion.measured_rows import Block
from ttus_opt.voxmap.field import PotentialField

COMPONENTS = ("fx", "fy", "fz", "tx", "ty", "tz")


@dataclass(frozen=True, eq=False)
class Innovation:
    """Difference between one measurement and its prediction.

    Attributes:
        index: Number of the measurement, from 0, for `RecursiveFit.downdate`.
        components: Those of fx, fy, fz, tx, ty, tz with weight, k names.
        innovation: Measured minus predicted, ν, shape (k,) [N, N·m].
        covariance: Its predicted covariance, S, shape (k, k) [N², N²·m, N²·m²].
        nis: Normalised innovation squared νᵀS⁻¹ν, χ² with k degrees of freedom when
            the weights are right [–].
        threshold: Largest accepted ``nis``; infinite without a test [–].
        accepted: Whether the measurement is held.
        contact_points: Shell points inside the patient; without any, the measurement
            does not affect the field [–].
        in_grid: Whether any shell point lies within the grid.
        seconds: Time the update took [s].
    """

    index: int
    components: tuple[str, ...]
    innovation: Array
    covariance: Array = field(repr=False)
    nis: float
    threshold: float
    accepted: bool
    contact_points: int
    in_grid: bool
    seconds: float = field(compare=False)


class RecursiveFit:
    """The field of all measurements so far, equal to the batch fit of eq. 10.

    Memory follows the rank k of the measurements, not the voxels: besides the sparse
    rows and three vectors of V, at most n k numbers are held, with n six rows for each
    measurement in contact (three where one weight is zero). Repeated motion keeps k
    small: 550 after 1,200 presses and sweeps of the bundled recordings on 51,840
    voxels, 32 MB; 400 presses all over a torso have k = 1,475 and 29 MB.

    Time per measurement: twelve solves with the block A on all cores, O(k²), and O(n k)
    for each new column; a pose without contact costs only the search for its points.
    Measurements may be added, faded and removed any number of times: only the list of
    rejected ones grows. Use an instance in one thread at a time; fields that it has
    returned do not change.

    Attributes:
        scene: Patient and probe; its measurements were added first.
        capacity: Most measurements in contact that may be held [–].
    """

    def __init__(
        self,
        scene: Scene,
        *,
        force_weight: float = 1e-2,
        torque_weight: float = 1e-2,
        torque_length: float | None = None,
        capacity: int = 2000,
        outlier_level: float | None = 1e-6,
        noise_std: float | None = None,
        fold_scene: bool = True,
    ) -> None:
        """Start from a scene.

        Args:
            scene: Patient, probe and, where its trajectory has wrenches, the first
                measurements; these are added without a test, one by one.
            force_weight: λ_f of eq. 10 [–].
            torque_weight: λ_τ [–]; 0 where the scene has forces alone.
            torque_length: ℓ, by default the shell's root-mean-square radius [m].
            capacity: Most measurements in contact that may be held [–].
            outlier_level: Probability with which a good measurement is rejected by
                the χ² test of its innovation; None accepts all [–].
            noise_std: Standard deviation of a measured force component, which scales
                all predicted covariances; by default 1/√λ_f, that of the weight for a
                prior of unit variance, far larger than any sensor's. Give it to detect
                more than gross outliers [N].
            fold_scene: Whether the scene's own measurements are added.

        Raises:
            InputError: An option is not usable, or the scene holds more than
                ``capacity``.
            NumericalError: A solve did not reach its tolerance.
        """
        length = scene.torque_length if torque_length is None else torque_length
        if scene.measures_force_only:
            torque_weight = 0.0
        _check_weights(force_weight, torque_weight, length)
        _check_options(capacity, outlier_level, noise_std)
        self.scene = scene
        self.capacity = capacity
        roots = [math.sqrt(force_weight), math.sqrt(torque_weight) / length]
        scales = np.repeat(roots, 3)
        self._used = np.flatnonzero(scales)
        self._scales = scales[self._used]
        # the weight that noise_std refers to
        self._lead = force_weight or torque_weight
        self._variance = 1.0 if noise_std is None else self._lead * noise_std**2
        self._threshold = math.inf
        if outlier_level is not None:
            self._threshold = float(chdtri(len(self._used), outlier_level))
        self._system = DualRecursion(scene.laplace, scene.b, height=len(self._used))
        # numbers of the measurements held, in contact (one block each) and not
        self._slots: list[int] = []
        self._silent: list[int] = []
        self._rejected: list[int] = []
        self._count = 0
        if fold_scene and scene.trajectory.has_wrench:
            self._fold_scene()

    def __repr__(self) -> str:
        return (
            f"<RecursiveFit on {self.scene.voxmap.grid.sizes}: {self.measurements} "
            f"measurements held, {len(self.in_contact)} in contact>"
        )

    @property
    def measurements(self) -> int:
        """Number of measurements held, including those without contact [–]."""
        return len(self._slots) + len(self._silent)

    @property
    def in_contact(self) -> tuple[int, ...]:
        """Numbers of the held measurements in contact."""
        return tuple(self._slots)

    @property
    def rejected(self) -> tuple[int, ...]:
        """Numbers of the measurements that failed the test."""
        return tuple(self._rejected)

    @property
    def memory_bytes(self) -> int:
        """Memory that grows with the measurements."""
        return self._system.memory_bytes

    @property
    def estimated_noise_std(self) -> float:
        """The most likely ``noise_std`` for the measurements in contact [N].

        1/√λ_f times the root mean square of the normalised innovations; NaN before the
        first. With λ_f = 0 it is that of torque over ℓ.
        """
        system = self._system
        if not system.n_rows:
            return math.nan
        return math.sqrt(system.misfit / system.n_rows / self._lead)

    @property
    def field(self) -> PotentialField:
        """The current field, equal to the batch fit.

        Computed on access: a copy if nothing has changed, else two solves with L per
        round of refinement, usually two or three, and O(n k).

        Raises:
            NumericalError: The refinement did not converge.
        """
        scene = self.scene
        return PotentialField(
            scene.voxmap,
            scene.voxmap.grid.unflatten(self._system.field()),
            scene.sampling,
            scene.parameters,
            {"formulation": "eq10", "solver": "recursion"},
        )

    def update(
        self,
        rotation: Array,
        position: Array,
        force: Array,
        torque: Array | None = None,
    ) -> Innovation:
        """Add one measurement, unless it is an outlier.

        Args:
            rotation: Probe to patient, shape (3, 3) [–].
            position: Origin of the probe frame, patient frame, shape (3,) [m].
            force: Force on the probe, patient axes, shape (3,) [N].
            torque: About the shell's reference point, shape (3,) [N·m]; optional where
                torques have no weight.

        Returns:
            The innovation. A pose without contact is held without a test and does not
            change the field.

        Raises:
            InputError: Unusable pose or wrench, or the capacity is reached; the fit
                does not change.
            NumericalError: A solve did not reach its tolerance; likewise.
        """
        start = time.perf_counter()
        rotation = _checked(rotation, (3, 3), "rotation (3, 3)")
        position = _checked(position, (3,), "position (3,) [m]")
        force = _checked(force, (3,), "force (3,) [N]")
        if torque is None and (self._used >= 3).any():
            raise InputError(
                "a measurement needs torque (3,) [N·m]: give it, or start the fit with "
                "torque_weight=0"
            )
        given = np.zeros(3) if torque is None else torque
        torque = _checked(given, (3,), "torque (3,) [N·m]")
        checked_poses(rotation[None], position[None])
        if np.linalg.det(rotation) < 0.0:
            raise InputError("rotation is a reflection: its determinant must be +1")
        scene = self.scene
        rows = contact_rows(
            scene.voxmap,
            scene.shell,
            rotation[None],
            position[None],
            sampling=scene.sampling,
        )
        return self._fold(
            rows, 0, np.concatenate([force, torque]), self._threshold, start
        )

    def downdate(self, index: int) -> None:
        """Remove one measurement, as if it had never been made.

        O(n k + k³). Of a quarter as many removals as there are measurements held, the
        last takes O(n k²) and a pair of solves with A at most for each of their rows.

        Args:
            index: Its number, `Innovation.index`.

        Raises:
            InputError: No such measurement is held.
        """
        if index in self._silent:
            self._silent.remove(index)
        elif index in self._slots:
            slot = self._slots.index(index)
            self._system.remove(slot, 1)
            del self._slots[slot]
        else:
            raise InputError(
                f"measurement {index} is not in the fit: it was rejected, removed "
                f"before or never made ({self.measurements} are held of {self._count})"
            )

    def forget(self, factor: float | None = None, *, window: int | None = None) -> None:
        """Fade or remove old measurements; give exactly one of the two.

        Args:
            factor: Multiplies the weight of every measurement held, in (0, 1]; later
                ones have full weight. The field is that of the batch fit with these
                weights. Costs O(n k²) and temporarily two full k × k matrices [–].
            window: Number of newest measurements to keep; the others are removed as by
                `downdate` [–].

        Raises:
            InputError: Neither or both are given, or a value is out of range.
        """
        if (factor is None) == (window is None):
            raise InputError(
                "forget takes either a factor or a window: give one of them"
            )
        if factor is not None:
            self._system.fade(factor)
            return
        assert window is not None
        expect_not_negative(window, "window")
        held = sorted([*self._slots, *self._silent])
        gone = set(held[: max(0, len(held) - window)])
        # slots are in the order of time
        first = len(gone.intersection(self._slots))
        self._system.remove(0, first)
        del self._slots[:first]
        self._silent = [i for i in self._silent if i not in gone]

    def _fold_scene(self) -> None:
        scene = self.scene
        force = scene.f.reshape(-1, 3)
        only = scene.measures_force_only
        torque = np.zeros_like(force) if only else scene.tau.reshape(-1, 3)
        wrenches = np.hstack([force, torque])
        for t, wrench in enumerate(wrenches):
            self._fold(scene.rows, t, wrench, math.inf, time.perf_counter())

    def _fold(
        self, rows: ContactRows, t: int, wrench: Array, limit: float, start: float
    ) -> Innovation:
        """Predict, test and add pose t of some rows."""
        block = self._block(rows, t)
        target = wrench[self._used] * self._scales
        surprise, schur = target, np.eye(len(target))
        forecast = None
        if len(block.voxels):
            if len(self._slots) >= self.capacity:
                raise InputError(
                    f"capacity of {self.capacity} measurements in contact is reached: "
                    "forget old measurements or start with a larger capacity"
                )
            forecast = self._system.forecast(block)
            surprise, schur = target - forecast.mean, forecast.schur
        else:
            limit = math.inf
        nis = float(surprise @ np.linalg.solve(schur, surprise)) / self._variance
        index = self._count
        if nis > limit:
            self._rejected.append(index)
        elif forecast is None:
            self._silent.append(index)
        else:
            self._system.append(forecast, target)
            self._slots.append(index)
        self._count += 1
        return Innovation(
            index,
            tuple(COMPONENTS[c] for c in self._used),
            surprise / self._scales,
            schur * self._variance / np.outer(self._scales, self._scales),
            nis,
            limit,
            nis <= limit,
            int(rows.contact_points[t]),
            bool(rows.in_grid[t]),
            time.perf_counter() - start,
        )

    def _block(self, rows: ContactRows, t: int) -> Block:
        """Weighted rows of pose t; all of a pose's rows share their voxels."""
        low, high = int(rows.N.indptr[3 * t]), int(rows.N.indptr[3 * t + 3])
        count = (high - low) // 3
        both = [m.data[low:high].reshape(3, count) for m in (rows.N, rows.W)]
        values = np.ascontiguousarray(np.concatenate(both)[self._used].T)
        return Block(rows.N.indices[low : low + count], values * self._scales)


def _checked(values: Array, shape: tuple[int, ...], what: str) -> Array:
    """Return a finite array of the right shape."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape:
        raise InputError(f"a measurement needs {what}, got shape {array.shape}")
    if not np.isfinite(array).all():
        raise InputError(f"{what} contains NaN or infinity: drop that measurement")
    return array


def _check_weights(force_weight: float, torque_weight: float, length: float) -> None:
    expect_not_negative(force_weight, "force_weight")
    expect_not_negative(torque_weight, "torque_weight")
    if force_weight == 0.0 and torque_weight == 0.0:
        raise InputError(
            "both weights are 0: give force_weight or torque_weight a positive value"
        )
    expect_positive(length, "torque_length", "m")


def _check_options(
    capacity: int, outlier_level: float | None, noise_std: float | None
) -> None:
    if capacity < 1:
        raise InputError(f"capacity must be at least 1 measurement, got {capacity}")
    if outlier_level is not None and not 0.0 < outlier_level < 1.0:
        raise InputError(
            f"outlier_level is a probability between 0 and 1, got {outlier_level}: "
            "None accepts every measurement"
        )
    if noise_std is not None:
        expect_positive(noise_std, "noise_std", "N")
