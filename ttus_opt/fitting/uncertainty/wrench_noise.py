"""Noise of measured wrenches relative to a field: sensor and model errors.

With w = (f, τ) rendered by the field in a frame, the error of a measured wrench is

    e = s + r w + c w + (t × f, 0) + (0, o × f).

The sensor noise s of each component and the relative error r are independent in every
frame. The relative error c, the rotation t of the force and the shift o of its line of
action are common to all frames of a place; they stand for model errors there. Of a
depth map the first grows with the root of the force, as c √(w₀/‖f‖) w. All are normal
with mean zero, so that the covariance Σ of all rows is block-diagonal by frame plus
seven columns per place. The prior's variance and the noise are estimated together by
marginal likelihood, with weak log-normal priors. See docs/method/identification.md,
Uncertainty.

Source: C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning
(2006), eq. 2.30.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.errors import InputError, warn
from ttus_opt.gaussian.conditioned import conditioned
from ttus_opt.gaussian.posterior_mode import posterior_mode

#: Priors of the noise: median, and standard deviation of the logarithm
PRIORS = {
    "force": (0.05, 0.7),
    "share": (0.03, 0.7),
    "place_share": (0.08, 0.5),
    "turn": (0.03, 0.7),
    "torque": (0.002, 0.7),
    "shift": (0.001, 0.7),
}

#: Parameters that need measured torques
TORQUE = ("torque", "shift")

#: Relative error c of a place that no model has: a likelihood that runs up to it takes
#: variation of the tissue, which the field is to learn, for noise [–]
MOST_SHARE = 0.25

#: Least c of a depth map: further presses at fitted places err as if by 1.2 to 3.2 %,
#: in the median of 14 fits by 2.1 %, where c is found to be 1.2 to 3.4 % [–]
LEAST_SHARE = 0.022

#: Share of that limit from which c counts as having run to it: the search ends on
#: either side of the limit, where the density has a corner
AT_LIMIT = 0.95

#: Force below which the relative error c of a place grows no more [N]
LEAST_FORCE = 1e-3

#: Name of the prior's variance, and standard deviation of its logarithm [–]
VARIANCE, VARIANCE_SPREAD = "variance", 2.0

#: Most frames in the evidence, and most evaluations
MOST_FRAMES, MOST = 150, 300

#: Standard deviation of a combination of fields in all these frames, over the sensor's
#: noise, below which the frames do not tell it [–]
NEGLECTED = 0.01


@dataclass(frozen=True)
class WrenchNoise:
    """Standard deviations of the error of a measured wrench.

    Attributes:
        force: Sensor noise s of a force component [N].
        share: Relative error r, per frame [–].
        place_share: Relative error c, per place [–].
        turn: Rotation t about an axis, per place [rad].
        torque: Sensor noise s of a torque component; NaN where none was measured [N·m].
        shift: Shift o along an axis, per place; NaN where no torque was measured [m].
        usual_force: w₀, the force at which c is the relative error, which decreases
            with the root of the force; NaN where c is that of every force [N].
    """

    force: float
    share: float
    place_share: float
    turn: float
    torque: float = np.nan
    shift: float = np.nan
    usual_force: float = np.nan

    def own(self, wrench: Array) -> Array:
        """Covariance of the errors per frame, shape (T, 6, 6).

        Args:
            wrench: Rendered force [N] and torque [N·m], shape (T, 6).
        """
        sensor = np.repeat([self.force**2, self.torque**2], 3)
        relative = self.share**2 * wrench[:, :, None] * wrench[:, None, :]
        return np.asarray(np.diag(np.nan_to_num(sensor)) + relative)

    def shared(self, wrench: Array) -> Array:
        """Columns of the errors per place, shape (T, 6, 7); arguments as for `own`."""
        out = np.zeros((len(wrench), 6, 7))
        out[:, :, 0] = self.place_share * wrench
        if np.isfinite(self.usual_force):
            size = np.linalg.norm(wrench[:, :3], axis=1, keepdims=True)
            out[:, :, 0] *= np.sqrt(self.usual_force / np.maximum(size, LEAST_FORCE))
        turned = np.cross(np.eye(3), wrench[:, None, :3]).transpose(0, 2, 1)
        out[:, :3, 1:4] = self.turn * turned
        out[:, 3:, 4:] = np.nan_to_num(self.shift) * turned
        return out

    def covariance(self, wrench: Array) -> Array:
        """Covariance of the whole error of every frame, shape (T, 6, 6).

        NaN for a torque that was not measured; arguments as for `own`.
        """
        return self.of_model(wrench) + self.of_frame(wrench)

    def of_model(self, wrench: Array) -> Array:
        """That part of it by which a model is wrong at a place, shape (T, 6, 6)."""
        columns = self.shared(wrench)
        return np.asarray(columns @ columns.transpose(0, 2, 1))

    def of_frame(self, wrench: Array) -> Array:
        """The other, new in every frame; NaN for a torque that was not measured."""
        out = self.own(wrench)
        if np.isnan(self.torque):
            out[:, 3:] = out[:, :, 3:] = np.nan
        return out

    def as_dict(self) -> dict[str, float]:
        """Known values by name, for JSON."""
        return {name: v for name, v in asdict(self).items() if not np.isnan(v)}

    @classmethod
    def from_dict(cls, values: Mapping[str, float]) -> WrenchNoise:
        """The inverse of `as_dict`.

        Raises:
            InputError: Numbers that are negative or not finite.
            TypeError: Not a mapping, or wrong names.
        """
        numbers = {name: float(value) for name, value in dict(values).items()}
        if not all(0.0 <= value < np.inf for value in numbers.values()):
            raise InputError(f"noise must not be negative or infinite, got {numbers}")
        return cls(**numbers)


@dataclass(frozen=True)
class ErrorModel:
    """Prior variance and noise of weighted measured rows.

    Attributes:
        variance: Variance of the field's prior, over that of the program [–].
        root: Σ = root rootᵀ, shape (rows, k): a column per error of a frame, or of a
            row, and per error of a place [–].
    """

    variance: float
    root: sp.csr_array = field(repr=False)

    def draw(self, rng: np.random.Generator) -> Array:
        """Errors of all rows, shape (rows,)."""
        return np.asarray(self.root @ rng.standard_normal(self.root.shape[1]))


@dataclass(frozen=True)
class MeasuredWrenches:
    """Frames in contact, over a basis of fields.

    Attributes:
        images: Rows of the basis, shape (k, n, h) [N, N·m].
        misfit: Measurement minus the prior's mean, shape (n, h) [N, N·m].
        wrench: Wrenches rendered by the fit, shape (n, 6) [N, N·m].
        place: Place of every frame, shape (n,) [–].
        parts: Measured components of the wrench, shape (h,) [–].
        usual_force: As in `WrenchNoise` [N].
    """

    images: Array = field(repr=False)
    misfit: Array = field(repr=False)
    wrench: Array = field(repr=False)
    place: IntArray = field(repr=False)
    parts: IntArray = field(repr=False)
    usual_force: float = np.nan

    def thinned(self) -> MeasuredWrenches:
        """At most `MOST_FRAMES` evenly spaced frames."""
        at = evenly(len(self.place))
        return replace(
            self,
            images=self.images[:, at],
            misfit=self.misfit[at],
            wrench=self.wrench[at],
            place=self.place[at],
        )

    def condensed(self, variance: float) -> MeasuredWrenches:
        """The same over only as many fields as the frames tell apart.

        Args:
            variance: Of the fields' coefficients, about [–].
        """
        size = np.array([PRIORS["force" if c < 3 else "torque"][0] for c in self.parts])
        seen = (self.images / size).reshape(len(self.images), -1)
        if len(seen) > seen.shape[1]:
            seen = np.linalg.qr(seen, mode="r")
        _, lengths, directions = np.linalg.svd(seen, full_matrices=False)
        kept = np.sqrt(variance) * lengths > NEGLECTED
        fewer = lengths[kept, None] * directions[kept]
        images = fewer.reshape(-1, *self.images.shape[1:]) * size
        return replace(self, images=images)

    def log_density(self, variance: float, noise: WrenchNoise) -> float:
        """Logarithm of the density of the measurements.

        Args:
            variance: Prior variance of the fields' coefficients [–].
            noise: Noise of the measurements.
        """
        k = len(self.images)
        frames, n_places = np.arange(len(self.place)), int(self.place.max()) + 1
        lower = np.linalg.cholesky(self._own(noise))
        columns = np.zeros((k + 7 * n_places + 1, *self.misfit.shape))
        columns[:k] = np.sqrt(variance) * self.images
        of_place = columns[k:-1].reshape(n_places, 7, *self.misfit.shape)
        of_place[self.place, :, frames] = self._shared(noise).transpose(0, 2, 1)
        columns[-1] = self.misfit
        white = np.linalg.solve(lower, np.moveaxis(columns, 0, 2))
        white = np.ascontiguousarray(white.reshape(-1, len(columns)).T)
        size = 0.5 * self.misfit.size * math.log(2.0 * math.pi)
        size += float(np.log(np.einsum("nii->ni", lower)).sum())
        return conditioned(white[:-1], white[-1]).log_density - size

    def estimate(
        self,
        variance: float,
        known: float | None = None,
        place_share: tuple[float, float] = PRIORS["place_share"],
    ) -> tuple[float, WrenchNoise]:
        """The most likely prior variance and noise.

        Where the relative error of places runs to `MOST_SHARE` it keeps the median of
        its prior, and a `TtusWarning` says so.

        Args:
            variance: Median of the prior variance [–].
            known: The prior variance, where it is not estimated [–].
            place_share: Prior of c: median, and standard deviation of the logarithm.
        """
        held = {} if known is None else {VARIANCE: known}
        priors = {VARIANCE: (variance, VARIANCE_SPREAD), **PRIORS}
        priors["place_share"] = place_share
        few = self.thinned().condensed(held.get(VARIANCE, variance))
        found, noise = few._likeliest(priors, held)
        if noise.place_share >= AT_LIMIT * MOST_SHARE:
            usual = place_share[0]
            warn(
                "uncertainty: the recordings do not tell errors of whole places, "
                f"which seem larger than {100 * MOST_SHARE:.0f} %, from what the "
                f"field does not know; {100 * usual:.0f} % of the wrench are taken "
                "for them",
                2,
            )
            return few._likeliest(priors, held | {"place_share": usual})
        return found, noise

    def _likeliest(
        self, priors: Mapping[str, tuple[float, float]], held: Mapping[str, float]
    ) -> tuple[float, WrenchNoise]:
        """The same, with some values held."""
        unknown = set(held) | (set() if max(self.parts) > 2 else set(TORQUE))
        names = [name for name in priors if name not in unknown]
        usual, spreads = np.array([priors[name] for name in names]).T
        medians = np.log(usual)

        def values(steps: Array) -> tuple[float, WrenchNoise]:
            at = np.exp(medians + spreads * np.clip(steps, -6.0, 6.0))
            found = dict(held) | dict(zip(names, map(float, at), strict=True))
            own = found.pop(VARIANCE)
            noise = WrenchNoise(**found, usual_force=self.usual_force)
            share = min(noise.place_share, MOST_SHARE)
            return own, replace(noise, place_share=share)

        def log_density(steps: Array) -> float:
            return self.log_density(*values(steps))

        return values(posterior_mode(log_density, len(names), MOST).steps)

    def errors(
        self,
        variance: float,
        noise: WrenchNoise,
        mixed: sp.csr_array,
        at: IntArray,
        of_row: float | None = None,
    ) -> ErrorModel:
        """The error model of weighted rows.

        Args:
            variance: Prior variance [–].
            noise: Noise of the measurements.
            mixed: From measured components to weighted rows, shape (rows, components)
                [1/N, 1/N·m].
            at: Column in it of every component, shape (n, h).
            of_row: Standard deviation of every weighted row, where that and the
                relative error of a place are all errors [–].
        """
        shared, (rows, n) = self._shared(noise), mixed.shape
        if of_row is None:
            own = np.asarray(np.linalg.cholesky(self._own(noise)))
            each = np.arange(own[..., 0].size).reshape(len(own), 1, -1)
            first: sp.csr_array = mixed @ _placed(own, at, each, n)
        else:
            shared, first = shared[..., :1], of_row * sp.eye_array(rows, format="csr")
        count = shared.shape[2]
        of_place = count * self.place[:, None, None] + np.arange(count)
        second = mixed @ _placed(shared, at, of_place, n)
        return ErrorModel(variance, sp.csr_array(sp.hstack([first, second])))

    def _own(self, noise: WrenchNoise) -> Array:
        return noise.own(self.wrench)[:, self.parts][:, :, self.parts]

    def _shared(self, noise: WrenchNoise) -> Array:
        return noise.shared(self.wrench)[:, self.parts]


def evenly(count: int) -> slice:
    """At most `MOST_FRAMES` evenly spaced of some frames."""
    return slice(None, None, -(-count // MOST_FRAMES))


def _placed(values: Array, at: IntArray, columns: IntArray, n: int) -> sp.csr_array:
    """Values (frames, h, k) in the rows ``at`` of n components, and given columns."""
    whole = np.broadcast_arrays(at[..., None], columns, values)
    row, column, data = (part.ravel() for part in whole)
    return sp.csr_array((data, (row, column)), shape=(n, int(column.max()) + 1))
