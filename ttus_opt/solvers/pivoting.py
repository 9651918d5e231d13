"""Block principal pivoting: all wrong signs change sides at once.

For a linear complementarity problem with a positive definite matrix that takes few
exchanges, but may cycle; where the number of wrong signs does not fall, the last one
alone changes, which cannot (Murty's rule; Júdice and Pires, Comput. Oper. Res. 21,
1994).
"""

from __future__ import annotations

import sys

import numpy as np

from ttus_opt.core.arrays import Mask


class BlockPivoting:
    """The exchanges of one problem.

    Attributes:
        best: The set with the fewest wrong signs so far; None at first.
    """

    def __init__(self, tries: int = 0) -> None:
        """Start.

        Args:
            tries: Exchanges of all wrong signs allowed without fewer of them [–].
        """
        self.best: Mask | None = None
        self._tries = self._left = tries
        self._fewest = sys.maxsize

    def following(self, active: Mask, wrong: Mask) -> Mask | None:
        """The next set after one and its wrong signs; None without any."""
        count = int(np.count_nonzero(wrong))
        if count < self._fewest:
            self.best, self._fewest, self._left = active, count, self._tries
        elif self._left:
            self._left -= 1
        else:
            wrong = np.arange(len(wrong)) == np.flatnonzero(wrong)[-1]
        return active ^ wrong if count else None
