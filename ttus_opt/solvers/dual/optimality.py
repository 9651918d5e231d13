"""KKT violations of a working set, and the working set that follows from them.

There are two kinds: a limit that is not satisfied, and an active limit whose multiplier
has the wrong sign. Without any, the minimiser is found.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.solvers.dual.limits import Multipliers, SpokeLimits
from ttus_opt.solvers.dual.working_set import WorkingSet, one_bound_each


@dataclass(frozen=True)
class Violations:
    """Sizes of violations of limits and of wrong signs; positive if violated.

    Attributes:
        bounds: By voxel, shape (V,).
        side: Which bound is violated, -1 or +1, shape (V,).
        links: By order constraint, shape (V,).
    """

    bounds: Array
    side: NDArray[np.int8]
    links: Array

    @property
    def count(self) -> int:
        """Number of violations [–]."""
        bounds = int(np.count_nonzero(self.bounds > 0.0))
        return bounds + int(np.count_nonzero(self.links > 0.0))

    @property
    def worst(self) -> float:
        """The largest relative violation [–]."""
        return float(max(self.bounds.max(), self.links.max()))

    def among(self, bounds: Mask, links: Mask) -> Violations:
        """Only the violations of these bounds and links."""
        return replace(
            self,
            bounds=np.where(bounds, self.bounds, -np.inf),
            links=np.where(links, self.links, -np.inf),
        )

    def worse_half(self) -> Violations:
        """The larger half of the violations."""
        sizes = np.concatenate([self.bounds, self.links])
        kept = np.zeros(len(sizes), dtype=bool)
        kept[np.argsort(sizes)[len(sizes) - self.count // 2 :]] = True
        return self.among(*np.split(kept, 2))

    def pivoted(self, limits: SpokeLimits, active: WorkingSet) -> WorkingSet:
        """The working set with each of these limits changed: activated or released."""
        bounds, links = self.bounds > 0.0, self.links > 0.0
        other = np.where(active.bounds != 0, 0, self.side)
        changed = np.where(bounds, other, active.bounds).astype(np.int8)
        return one_bound_each(limits, WorkingSet(changed, active.links ^ links))


def multipliers(
    limits: SpokeLimits, active: WorkingSet, gradient: Array
) -> Multipliers:
    """Multipliers of active limits that balance the objective's gradient.

    In a block the multiplier of a link is the sum of the gradients from the block's end
    to the link, towards the voxel at a bound. In a block without a bound the gradients
    sum to zero.

    Args:
        limits: The limits.
        active: Which are active; at most one bound per block.
        gradient: Gradient of the objective, shape (V,).
    """
    g = limits.by_layer(gradient)
    links = limits.by_layer(active.links)
    held = limits.by_layer((active.bounds != 0) | limits.given)
    inner, outer = g.copy(), g.copy()
    deeper = held.copy()  # whether the block is held here or deeper
    for i in range(1, len(g)):
        deeper[i] |= links[i - 1] & deeper[i - 1]
        inner[i] += np.where(links[i - 1] & ~deeper[i - 1], inner[i - 1], 0.0)
    for i in range(len(g) - 2, -1, -1):
        outer[i] += np.where(links[i], outer[i + 1], 0.0)
    of_links = np.zeros_like(g)
    of_links[:-1] = np.where(deeper[:-1], -outer[1:], inner[:-1])
    of_links = np.where(links, of_links, 0.0)
    of_bounds = np.where(held, -(inner + outer - g), 0.0)
    return Multipliers(of_bounds.reshape(-1), of_links.reshape(-1))


def right_signs(
    limits: SpokeLimits, active: WorkingSet, signs: Multipliers
) -> Multipliers:
    """Multipliers whose wrong signs, which are small by now, are set to zero."""
    lower, upper = np.minimum(signs.bounds, 0.0), np.maximum(signs.bounds, 0.0)
    bounds = np.where(active.bounds < 0, lower, upper)
    bounds = np.where(limits.given, signs.bounds, bounds)
    return Multipliers(bounds, np.maximum(signs.links, 0.0))


def find_violations(
    limits: SpokeLimits,
    active: WorkingSet,
    p: Array,
    signs: Multipliers,
    gradient: Array,
) -> Violations:
    """Violations of limits over the largest value, wrong signs over the gradient's.

    Args:
        limits: The limits.
        active: Which are active.
        p: The field, shape (V,).
        signs: The result of `multipliers`.
        gradient: Gradient of the objective, shape (V,).
    """
    size = max(float(np.abs(p).max()), np.finfo(float).tiny)
    force = max(float(np.abs(gradient).max()), np.finfo(float).tiny)
    held = (active.bounds != 0) | limits.given
    below, above = limits.lower - p, p - limits.upper
    beyond = np.where(held, -np.inf, np.maximum(below, above) / size)
    backwards = -signs.bounds * active.bounds / force
    backwards = np.where(active.bounds != 0, backwards, -np.inf)
    growth = np.full(len(p), np.inf)
    growth[: -limits.stride] = p[: -limits.stride] - p[limits.stride :]
    short = (limits.least - growth) / size
    short = np.where(active.links, -signs.links / force, short)
    short[~np.isfinite(limits.least)] = -np.inf
    return Violations(
        np.maximum(beyond, backwards),
        np.where(below > above, -1, 1).astype(np.int8),
        short,
    )
