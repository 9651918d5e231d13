"""Stated uncertainty against errors, as curves to draw.

The first curve has, for every central interval of the stated normal distribution, the
share of measured components that lie within it: where standard deviations are right, an
interval for 80 % of the components holds 80 % of them. For the second, frames are
grouped by their stated standard deviation; the error of each group should equal it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np

from ttus_opt.core.arrays import Array

#: Errors and their standard deviations
Spread = tuple[Array, Array]

#: Shares that central intervals are stated to hold [–]
LEVELS = (*np.round(np.arange(0.05, 1.0, 0.05), 2), 0.99)

#: Most groups of frames, and fewest frames of one [–]
GROUPS, LEAST_FRAMES = 8, 5


@dataclass(frozen=True)
class CalibrationCurve:
    """Stated uncertainty, noise of measurements included, against errors.

    Attributes:
        level: Share that an interval is stated to hold, shape (k,) [–].
        force: Share of the measured force components that it does hold, (k,) [–].
        torque: The same for torque; NaN where none was measured.
        stated_N: Root mean square of the stated standard deviation of the whole force
            in groups of frames, of least to most, shape (g,).
        error_N: Root mean square of the error of force in the same groups, (g,).
    """

    level: Array = field(repr=False)
    force: Array = field(repr=False)
    torque: Array = field(repr=False)
    stated_N: Array
    error_N: Array

    @property
    def coverage(self) -> float:
        """Share of force components within the 95 % interval [–]."""
        return float(self.force[np.argmin(np.abs(self.level - 0.95))])

    def as_dict(self) -> dict[str, Any]:
        """Lists by name, for JSON."""
        return {name: values.tolist() for name, values in vars(self).items()}

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> Self:
        """Inverse of `as_dict`; null is NaN."""
        return cls(**{k: np.array(v, dtype=np.float64) for k, v in content.items()})

    @classmethod
    def of(cls, force: Spread, torque: Spread | None = None) -> Self:
        """From the errors of frames.

        Args:
            force: Error of force and its standard deviation, (n, 3) each [N].
            torque: The same for torque [N·m]; None where none was measured.
        """
        error, std = force
        size, off = np.sum(std**2, axis=1), np.sum(error**2, axis=1)
        groups = max(1, min(GROUPS, len(error) // LEAST_FRAMES))
        frames = np.array_split(np.argsort(size, kind="stable"), groups)
        return cls(
            np.array(LEVELS),
            _shares(force),
            np.full(len(LEVELS), np.nan) if torque is None else _shares(torque),
            np.sqrt([size[some].mean() for some in frames]),
            np.sqrt([off[some].mean() for some in frames]),
        )


def _shares(spread: Spread) -> Array:
    """Share of components within each central interval of a normal distribution."""
    from scipy.special import ndtri

    error, std = spread
    within = ndtri(0.5 + 0.5 * np.array(LEVELS))
    return np.array([(np.abs(error) <= k * std).mean() for k in within])
