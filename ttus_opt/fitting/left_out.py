"""Does a richer model predict left-out presses worse than a simpler one?

With fixed hyperparameters, the prediction of one press from all others has a closed
form (`weight_criteria.left_out_errors`) and needs no new fit. Frames of one press are
alike, so a press counts once, with the mean length of f - f̂ over its frames. The richer
model was chosen by its evidence, which already accounts for its flexibility; it is
rejected only where its error is larger by more than a standard error over the presses.
See docs/method.md, "Tuning".
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any, Self

import numpy as np

from ttus_opt.arrays import Array, IntArray
from ttus_opt.blas_threads import one_blas_thread
from ttus_opt.errors import InputError
from ttus_opt.fitting.covariance_posterior import CovariancePosterior
from ttus_opt.fitting.weight_criteria import left_out_errors, presses
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.terms.structure import known_covariance

#: Fewest presses for a comparison, so that the remaining ones lie at several places [–]
LEAST_PRESSES = 3

#: Most frames used for a prior of known covariance [–]
MOST_FRAMES = 200


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
    def clear(self) -> bool:
        """Whether its error is smaller by more than a standard error."""
        return self.made and -self._excess > self.difference_error

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


@one_blas_thread()
def left_out_of(declared: Formulation) -> LeftOut:
    """Leave presses out of a formulation whose prior has a known covariance.

    Its options, and a searched coefficient, are as declared. At most `MOST_FRAMES`
    evenly spaced frames are used, each weighted by the number it stands for.

    Raises:
        InputError: Its prior is of another kind, or no force is measured in contact.
    """
    program, scene = declared.compile(), declared.scene
    prior = next((t for t in program.terms if known_covariance(t.tags)), None)
    frames = np.flatnonzero(scene.rows.contact_points > 0)
    measured = [t for t in program.terms if t is not prior and t.weight > 0.0]
    if prior is None or "force" not in {t.name for t in measured} or not len(frames):
        raise InputError(
            f"{declared.name} has no prior of known covariance, or no force in contact"
        )
    every = -(-len(frames) // MOST_FRAMES)
    frames = frames[::every]
    rows = (3 * frames[:, None] + np.arange(3)).ravel()
    thinned = [_some(term, rows, every) for term in measured]
    found = CovariancePosterior.of(prior, thinned)
    of_rows = np.tile(np.repeat(presses(scene)[frames], 3), len(thinned))[
        found.informative
    ]
    own, at = found.measured, [t.name for t in thinned].index("force")
    root = np.sqrt(thinned[at].weight / prior.weight)
    error = np.zeros(len(found.informative))
    left_out = left_out_errors(own.half, own.solve(own.misfit), of_rows)
    error[found.informative] = left_out / root
    force = error[at * len(rows) : (at + 1) * len(rows)].reshape(-1, 3)
    return LeftOut(declared.name, frames, np.linalg.norm(force, axis=1))


def _some(term: ProgramTerm, rows: IntArray, every: int) -> ProgramTerm:
    """Some rows of a measured term, each standing for ``every`` rows."""
    return replace(
        term,
        weight=every * term.weight,
        matrix=term.matrix[rows],
        target=term.target[rows],
    )
