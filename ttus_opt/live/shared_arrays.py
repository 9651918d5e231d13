"""Arrays in memory that two processes share: one writes, the other reads the newest.

Two buffers or more and a counter: the writer fills the buffer after the newest, then
advances the counter. The reader copies the newest buffer and looks at the counter
before and after: if the writer has meanwhile begun to fill that buffer again, the copy
is torn, and it is made anew. Neither ever waits for the other. One writer per array.
With more buffers a reader that comes late still finds all that was written.

The counter is written after the data by the same thread, and processors of the x86
family keep that order; on others a reader may see it late, never early by more than a
copy that the second look at the counter refuses.
"""

from __future__ import annotations

from multiprocessing import shared_memory

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array
from ttus_opt.core.closing import Closing
from ttus_opt.core.errors import NumericalError

#: Copies made before a reader gives up [–]: a writer would have to be faster than a
#: copy again and again
ATTEMPTS = 100


class SharedArray(Closing):
    """A vector of float64, written by one process and read by another.

    Attributes:
        name: By which another process attaches to it.
        size: Number of values [–].
    """

    def __init__(self, size: int, name: str | None = None, depth: int = 2) -> None:
        """Make one, or attach to one of the same size and depth by its name.

        Args:
            size: Number of values [–].
            name: Of one that exists.
            depth: How many of the last vectors it holds, at least 2 [–].
        """
        self._owner, self._depth = name is None, depth
        length = 8 * (2 + depth * size)
        self._memory = shared_memory.SharedMemory(
            name, create=self._owner, size=length if self._owner else 0
        )
        self.name, self.size = self._memory.name, size
        whole = np.ndarray((2 + depth * size,), np.int64, self._memory.buf)
        # what is being written, and what is complete
        self._counters: NDArray[np.int64] = whole[:2]
        self._buffers = whole[2:].view(np.float64).reshape(depth, size)
        if self._owner:
            whole[:] = 0

    @property
    def count(self) -> int:
        """How often it was written [–]."""
        return int(self._counters[1])

    def write(self, values: Array) -> None:
        """Publish new values, shape (size,)."""
        following = int(self._counters[1]) + 1
        self._counters[0] = following
        self._buffers[following % self._depth] = values
        self._counters[1] = following

    def read(self) -> tuple[Array, int]:
        """The newest values, and how often it was written; zeros before the first.

        Raises:
            NumericalError: Every copy was torn.
        """
        for _ in range(ATTEMPTS):
            count = int(self._counters[1])
            values = self._buffers[count % self._depth].copy()
            # with two buffers, it is filled again by the second write after this one
            if int(self._counters[0]) < count + self._depth:
                return values, count
        raise NumericalError(
            f"a shared array of {self.size} values is written faster than it is copied"
        )

    def since(self, count: int) -> Array:
        """All vectors after the first ``count``, oldest first, shape (k, size).

        Raises:
            NumericalError: Some were written over before they were read.
        """
        wanted = np.arange(count + 1, self.count + 1)
        values = self._buffers[wanted % self._depth]
        written = int(self._counters[0]) - count
        if written > self._depth:
            raise NumericalError(
                f"a shared array of {self._depth} vectors was read too late: {written} "
                "were written since"
            )
        return values

    def close(self) -> None:
        """Detach, and remove it where it was made here."""
        del self._counters, self._buffers
        self._memory.close()
        if self._owner:
            self._memory.unlink()
