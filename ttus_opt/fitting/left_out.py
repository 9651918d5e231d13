"""Does a richer model predict presses that it has not seen worse than a simpler one?

All hyperparameters given, what every press but one says of that one is a closed form
(`weight_criteria.left_out_errors`), so that no fit is made again. Frames of one press
are alike: a press is one witness, by the mean length of f - f̂ over its frames. The
richer model was chosen for its evidence, which counts its freedom already; so it gives
way only where it is worse by more than the presses scatter. See docs/method.md,
"Tuning".
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any, Self

import numpy as np

from ttus_opt.arrays import Array, IntArray
from ttus_opt.errors import InputError
from ttus_opt.fitting.covariance_posterior import CovariancePosterior
from ttus_opt.fitting.weight_criteria import left_out_errors, presses
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.terms.structure import known_covariance

#: With fewer presses, those that remain do not lie at several places [–]
LEAST_PRESSES = 3

#: Most frames that a prior of known covariance looks at [–]
MOST_FRAMES = 200


@dataclass(frozen=True)
class LeftOut:
    """Errors of forces on presses left out in turn.

    Attributes:
        model: What was fitted to the others, in words.
        frames: Which frames of the trajectory, increasing, shape (n,) [–].
        errors: ‖f - f̂‖ there, shape (n,) [N].
    """

    model: str
    frames: IntArray = field(repr=False)
    errors: Array = field(repr=False)

    def mean_over(self, press: IntArray) -> float:
        """Mean over presses of their mean error [N].

        Args:
            press: Which press each of the frames belongs to, shape (n,) [–].
        """
        return float(_means(self.errors, press).mean())


@dataclass(frozen=True)
class Check:
    """A richer model beside a simpler one, by presses left out.

    Attributes:
        richer: In words.
        simpler: In words.
        presses: How many there are [–].
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
        """Compare them press by press, on the frames that both have looked at.

        Args:
            richer: The richer model.
            simpler: The simpler one.
            press: Which press every frame of the trajectory belongs to, shape (T,) [–].
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
        """Whether there were presses enough."""
        return self.presses >= LEAST_PRESSES

    @property
    def holds(self) -> bool:
        """Whether the richer one stays: not worse by more than a standard error."""
        return not self.made or self._excess <= self.difference_error

    @property
    def better(self) -> bool:
        """Whether the richer one has the smaller error."""
        return self.made and self._excess < 0.0

    @property
    def clear(self) -> bool:
        """Whether it is smaller by more than a standard error."""
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
    """Mean of every press, in the order of their numbers."""
    _, place, count = np.unique(press, return_inverse=True, return_counts=True)
    return np.asarray(np.bincount(place, errors) / count)


def left_out_of(declared: Formulation) -> LeftOut:
    """Presses left out of a formulation whose prior has a known covariance.

    Its options, a coefficient to be searched for too, are as declared. At most
    `MOST_FRAMES` frames are looked at, evenly, each with the weight of those that it
    stands for.

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
    found = CovariancePosterior.of(program, prior, thinned)
    of_rows = np.tile(np.repeat(presses(scene)[frames], 3), len(thinned))[found.told]
    own, at = found.measured, [t.name for t in thinned].index("force")
    root = np.sqrt(thinned[at].weight / prior.weight)
    error = np.zeros(len(found.told))
    error[found.told] = left_out_errors(own.half, own.solve(own.misfit), of_rows) / root
    force = error[at * len(rows) : (at + 1) * len(rows)].reshape(-1, 3)
    return LeftOut(declared.name, frames, np.linalg.norm(force, axis=1))


def _some(term: ProgramTerm, rows: IntArray, every: int) -> ProgramTerm:
    """Some rows of a measured term, each for so many."""
    return replace(
        term,
        weight=every * term.weight,
        matrix=term.matrix[rows],
        target=term.target[rows],
    )
