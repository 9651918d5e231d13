"""What a measured wrench shows beside the field: sensor, tissue and press.

With w = (f, τ) what the field renders in a frame, the error of a measured wrench is

    e = s + r w + c w + (t × f, 0) + (0, o × f):

s the sensor's, of each component on its own, and r a share of the wrench, both new in
every frame; a share c, a turn t and a shift o of the line of action, the same in all
frames of a place. Those are what no field of this kind gives of the place. All are
normal with mean zero, so that the covariance Σ of all rows is block-diagonal by frame
plus seven columns per place. The prior's variance and the noise are found together by
marginal likelihood, with weak log-normal priors. See docs/method.md, Doubt.

Source: C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning
(2006), eq. 2.30.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace

import numpy as np
import scipy.linalg

from ttus_opt.arrays import Array, IntArray
from ttus_opt.errors import InputError
from ttus_opt.terms.posterior_mode import posterior_mode

#: Priors of the noise: median, and standard deviation of the logarithm
PRIORS = {
    "force": (0.05, 0.7),
    "share": (0.03, 0.7),
    "place_share": (0.08, 0.5),
    "turn": (0.03, 0.7),
    "torque": (0.002, 0.7),
    "shift": (0.001, 0.7),
}

#: What tells nothing where no torque was measured
TORQUE = ("torque", "shift")

#: Largest share of a place: beyond, fields would say nothing [–]
MOST_SHARE = 0.25

#: Standard deviation of the logarithm of the prior's variance [–]
VARIANCE_SPREAD = 2.0

#: Most frames that the evidence looks at, and most evaluations
MOST_FRAMES, MOST = 150, 300

#: A probe that has moved this far presses another place [m]
PLACE = 0.03


@dataclass(frozen=True)
class WrenchNoise:
    """Standard deviations of the error of a measured wrench.

    Attributes:
        force: Of a component, the sensor's [N].
        share: Of the wrench, of every frame on its own [–].
        place_share: Of the wrench, the same in all frames of a place [–].
        turn: Of the force about an axis, the same in all frames of a place [rad].
        torque: Of a component, the sensor's; NaN where none was measured [N·m].
        shift: Of the line of action along an axis, the same in all frames of a place;
            NaN where no torque was measured [m].
    """

    force: float
    share: float
    place_share: float
    turn: float
    torque: float = np.nan
    shift: float = np.nan

    def own(self, wrench: Array) -> Array:
        """Covariance of what every frame has on its own, shape (T, 6, 6).

        Args:
            wrench: Rendered force [N] and torque [N·m], shape (T, 6).
        """
        sensor = np.repeat([self.force**2, self.torque**2], 3)
        relative = self.share**2 * wrench[:, :, None] * wrench[:, None, :]
        return np.asarray(np.diag(np.nan_to_num(sensor)) + relative)

    def shared(self, wrench: Array) -> Array:
        """Columns that the frames of a place share, shape (T, 6, 7).

        Args:
            wrench: As of `own`.
        """
        out = np.zeros((len(wrench), 6, 7))
        out[:, :, 0] = self.place_share * wrench
        turned = np.cross(np.eye(3), wrench[:, None, :3]).transpose(0, 2, 1)
        out[:, :3, 1:4] = self.turn * turned
        out[:, 3:, 4:] = np.nan_to_num(self.shift) * turned
        return out

    def covariance(self, wrench: Array) -> Array:
        """Covariance of the whole error of every frame, shape (T, 6, 6).

        Args:
            wrench: As of `own`.

        Returns:
            NaN for a torque that was not measured.
        """
        columns = self.shared(wrench)
        out = self.own(wrench) + columns @ columns.transpose(0, 2, 1)
        if np.isnan(self.torque):
            out[:, 3:] = out[:, :, 3:] = np.nan
        return np.asarray(out)

    def as_dict(self) -> dict[str, float]:
        """What is known, by name, for JSON."""
        return {name: v for name, v in asdict(self).items() if not np.isnan(v)}

    @classmethod
    def from_dict(cls, values: Mapping[str, float]) -> WrenchNoise:
        """What `as_dict` gave.

        Raises:
            InputError: Numbers that are negative or not finite.
            TypeError: Other names, or one is missing; no mapping.
        """
        numbers = {name: float(value) for name, value in dict(values).items()}
        if not all(0.0 <= value < np.inf for value in numbers.values()):
            raise InputError(f"noise must not be negative or infinite, got {numbers}")
        return cls(**numbers)


@dataclass(frozen=True)
class ErrorModel:
    """Prior and noise of measured rows as weighted, and where the rows stand.

    Attributes:
        variance: Of the field's prior, over that of the program [–].
        own: Cholesky factor of every frame's own part, shape (n, h, h).
        shared: Columns that the frames of a place share, shape (n, h, 7).
        place: Which place a frame is of, shape (n,) [–].
        at: Which row of a program a component is, shape (n, h); -1 for none.
    """

    variance: float
    own: Array = field(repr=False)
    shared: Array = field(repr=False)
    place: IntArray = field(repr=False)
    at: IntArray = field(repr=False)

    def roots(self, rows: Array) -> Array:
        """Y with Y Yᵀ = B Σ Bᵀ, shape (k, n h + 7 places).

        Args:
            rows: B, shape (k, rows).
        """
        parts = by_frame(rows, self.at)
        own = np.einsum("knh,nhj->knj", parts, self.own).reshape(len(rows), -1)
        sums = np.zeros((int(self.place.max()) + 1, len(rows), 7))
        np.add.at(sums, self.place, np.einsum("knh,nhj->nkj", parts, self.shared))
        shared = sums.transpose(1, 0, 2).reshape(len(rows), -1)
        return np.concatenate([own, shared], axis=1)

    def draw(self, rng: np.random.Generator) -> Array:
        """Errors of all rows, shape (rows,)."""
        each = np.einsum("nhj,nj->nh", self.own, rng.standard_normal(self.at.shape))
        numbers = rng.standard_normal((int(self.place.max()) + 1, 7))
        each += np.einsum("nhj,nj->nh", self.shared, numbers[self.place])
        told = self.at >= 0
        out = np.zeros(int(told.sum()))
        out[self.at[told]] = each[told]
        return out


@dataclass(frozen=True)
class MeasuredWrenches:
    """Frames in contact, as a basis of fields sees them.

    Attributes:
        images: What the basis gives, shape (k, n, h) [N, N·m].
        misfit: What was measured beyond the prior's mean, shape (n, h) [N, N·m].
        wrench: What the fit renders, shape (n, 6) [N, N·m].
        place: Which place a frame is of, shape (n,) [–].
        parts: Which components of a wrench were measured, shape (h,) [–].
    """

    images: Array = field(repr=False)
    misfit: Array = field(repr=False)
    wrench: Array = field(repr=False)
    place: IntArray = field(repr=False)
    parts: IntArray = field(repr=False)

    def thinned(self) -> MeasuredWrenches:
        """At most `MOST_FRAMES` of the frames, evenly."""
        at = slice(None, None, -(-len(self.place) // MOST_FRAMES))
        return replace(
            self,
            images=self.images[:, at],
            misfit=self.misfit[at],
            wrench=self.wrench[at],
            place=self.place[at],
        )

    def log_density(self, variance: float, noise: WrenchNoise) -> float:
        """Logarithm of the density of the measurements.

        Args:
            variance: Of the prior of the fields' coefficients [–].
            noise: Of the measurements.
        """
        k, m = len(self.images), self.misfit.size
        frames, n_places = np.arange(len(self.place)), int(self.place.max()) + 1
        lower = np.linalg.cholesky(self._own(noise))
        columns = np.zeros((k + 7 * n_places + 1, *self.misfit.shape))
        columns[:k] = np.sqrt(variance) * self.images
        of_place = columns[k:-1].reshape(n_places, 7, *self.misfit.shape)
        of_place[self.place, :, frames] = self._shared(noise).transpose(0, 2, 1)
        columns[-1] = self.misfit
        white = np.linalg.solve(lower, np.moveaxis(columns, 0, 2))
        gram = np.tensordot(white, white, axes=([0, 1], [0, 1]))
        inner = gram[:-1, :-1] + np.eye(len(gram) - 1)
        factor = np.linalg.cholesky(inner)
        half = scipy.linalg.solve_triangular(factor, gram[:-1, -1], lower=True)
        size = float(np.log(np.diag(factor)).sum())
        size += float(np.log(np.einsum("nii->ni", lower)).sum())
        square = float(gram[-1, -1] - half @ half)
        return -0.5 * (square + m * math.log(2.0 * math.pi)) - size

    def estimate(self, variance: float) -> tuple[float, WrenchNoise]:
        """The likeliest prior variance and noise.

        Args:
            variance: About which the prior's lies [–].
        """
        few = self.thinned()
        names = [n for n in PRIORS if max(self.parts) > 2 or n not in TORQUE]
        told = [(variance, VARIANCE_SPREAD), *(PRIORS[n] for n in names)]
        medians, spreads = np.log([m for m, _ in told]), np.array([s for _, s in told])

        def values(steps: Array) -> tuple[float, WrenchNoise]:
            first, *others = np.exp(medians + spreads * np.clip(steps, -6.0, 6.0))
            noise = WrenchNoise(**dict(zip(names, map(float, others), strict=True)))
            share = min(noise.place_share, MOST_SHARE)
            return float(first), replace(noise, place_share=share)

        def log_density(steps: Array) -> float:
            return few.log_density(*values(steps))

        return values(posterior_mode(log_density, len(told), MOST).steps)

    def errors(
        self, variance: float, noise: WrenchNoise, scale: Array, at: IntArray
    ) -> ErrorModel:
        """The same of rows as weighted.

        Args:
            variance: Of the prior [–].
            noise: Of the measurements.
            scale: What a component of a frame is multiplied by, (h,) [1/N, 1/N·m].
            at: As of `ErrorModel`.
        """
        own = np.linalg.cholesky(self._own(noise)) * scale[:, None]
        shared = self._shared(noise) * scale[:, None]
        return ErrorModel(variance, own, shared, self.place, at)

    def _own(self, noise: WrenchNoise) -> Array:
        return noise.own(self.wrench)[:, self.parts][:, :, self.parts]

    def _shared(self, noise: WrenchNoise) -> Array:
        return noise.shared(self.wrench)[:, self.parts]


def by_frame(rows: Array, at: IntArray) -> Array:
    """Values of rows by frame and component, (..., n, h); 0 where there is no row.

    Args:
        rows: Shape (..., rows).
        at: As of `ErrorModel`.
    """
    return np.where(at >= 0, rows[..., np.maximum(at, 0)], 0.0)


def places(press: IntArray, position: Array) -> IntArray:
    """Number of the place every frame is of, shape (T,).

    A place is a run of frames of one press while the probe is within `PLACE` of where
    the run began.

    Args:
        press: Which press a frame belongs to, shape (T,) [–].
        position: Of the probe, shape (T, 3) [m].
    """
    out, number, start = np.zeros(len(press), dtype=np.int64), 0, 0
    for t in range(1, len(press)):
        away = float(np.linalg.norm(position[t] - position[start]))
        if press[t] != press[start] or away > PLACE:
            number, start = number + 1, t
        out[t] = number
    return out
