"""Does a richer model predict left-out presses worse than a simpler one?

With fixed hyperparameters, the prediction of one press from all others has a closed
form (`weight_criteria.left_out_errors`) and needs no new fit. Frames of one press are
alike, so a press counts once, with the mean length of f - f̂ over its frames. The richer
model was chosen by its evidence, which already accounts for its flexibility; it is
rejected only where its error is larger by more than a standard error over the presses.
See docs/method.md, "Tuning".
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, Self

import numpy as np

from ttus_opt.arrays import Array, IntArray

#: Fewest presses for a comparison, so that the remaining ones lie at several places [–]
LEAST_PRESSES = 3


@dataclass(frozen=True)
class LeftOut:
    """Force errors on presses left out in turn.

    Attributes:
        model: The fitted model, in words.
        frames: Frames of the trajectory, increasing, shape (n,) [–].
        errors: ‖f - f̂‖ there, shape (n,) [N].
    """

    model: str
    frames: IntArray = field(repr=False)
    errors: Array = field(repr=False)

    def mean_over(self, press: IntArray) -> float:
        """Mean over presses of their mean error [N].

        Args:
            press: The press of every frame in ``frames``, shape (n,) [–].
        """
        return float(_means(self.errors, press).mean())


@dataclass(frozen=True)
class Check:
    """Comparison of a richer with a simpler model on presses left out.

    Attributes:
        richer: The richer model, in words.
        simpler: The simpler model, in words.
        presses: Number of presses [–].
        richer_error: Mean over presses left out; NaN with too few [N].
        simpler_error: The same [N].
        difference_error: Standard error of their difference, over the presses [N].
    """

    richer: str
    simpler: str
    presses: int
    richer_error: float = np.nan
    simpler_error: float = np.nan
    difference_error: float = np.nan

    @classmethod
    def between(cls, richer: LeftOut, simpler: LeftOut, press: IntArray) -> Self:
        """Compare press by press, on the frames that both have.

        Args:
            richer: Errors of the richer model.
            simpler: Errors of the simpler one.
            press: The press of every frame of the trajectory, shape (T,) [–].
        """
        frames, *at = np.intersect1d(
            richer.frames, simpler.frames, assume_unique=True, return_indices=True
        )
        means = [
            _means(one.errors[own], press[frames])
            for one, own in zip((richer, simpler), at, strict=True)
        ]
        n = len(means[0])
        if n < LEAST_PRESSES:
            return cls(richer.model, simpler.model, n)
        spread = (means[0] - means[1]).std(ddof=1) / np.sqrt(n)
        rich, plain = (float(one.mean()) for one in means)
        return cls(richer.model, simpler.model, n, rich, plain, float(spread))

    @property
    def made(self) -> bool:
        """Whether there were enough presses."""
        return self.presses >= LEAST_PRESSES

    @property
    def holds(self) -> bool:
        """Whether the richer model is not worse by more than a standard error."""
        return not self.made or self._excess <= self.difference_error

    @property
    def better(self) -> bool:
        """Whether the richer model has the smaller error."""
        return self.made and self._excess < 0.0

    @property
    def _excess(self) -> float:
        return self.richer_error - self.simpler_error

    def __str__(self) -> str:
        if not self.made:
            return (
                f"{self.richer} could not be checked by presses left out: "
                f"{self.presses} of them are fewer than {LEAST_PRESSES}"
            )
        what = "better than" if self.better else "worse than"
        if self.holds and not self.better:
            what = "about as well as"
        return (
            f"{self.richer} predicts presses left out {what} {self.simpler} "
            f"({self.richer_error:.3f} N, {self.simpler_error:.3f} N, their "
            f"difference ± {self.difference_error:.2g} N over {self.presses} presses)"
        )

    def as_dict(self) -> dict[str, Any]:
        """All of it by name, for JSON."""
        return {**asdict(self), "made": self.made, "holds": self.holds}


def _means(errors: Array, press: IntArray) -> Array:
    """Mean per press, in the order of their numbers."""
    _, place, count = np.unique(press, return_inverse=True, return_counts=True)
    return np.asarray(np.bincount(place, errors) / count)
