"""What a V-cycle and a solve with A must move through memory, and how fast it can be.

Every pass of the multigrid streams over whole arrays, so that its bytes can be
counted from the arrays' sizes. Two counts: each array once, which caches of any size
cannot undercut, and each array once in every pass that touches it, which is what a
level larger than the cache costs. A pass over a block of radial lines goes forwards
and backwards; the block stays in cache, so it counts once.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ttus_opt.multigrid.hierarchy import Hierarchy, Level

#: An array counts as beyond a cache at so many times its size
BEYOND = 2

#: Size of the large copy where no cache is told [byte]
UNKNOWN_CACHE = 2**28

#: Copies of which the fastest counts, and how long they may take together [s]
COPIES, COPY_SECONDS = 50, 2.0

#: One colour of one array of one level: name, level, colour
Piece = tuple[str, int, int]
Pass = tuple[Piece, ...]


@dataclass(frozen=True)
class Traffic:
    """Bytes of a V-cycle, and of what a solve does around it.

    Attributes:
        once: Arrays a V-cycle touches, each moved once [byte].
        cycle: The same in every pass, reads and writes [byte].
        finest: What of ``cycle`` is on the finest level [byte].
        vectors: Conjugate gradients' vectors, per V-cycle, every pass [byte].
        correction: Residual, sum and colour change per correction [byte].
        level: One array of the finest level, both halves [byte].
    """

    once: int
    cycle: int
    finest: int
    vectors: int
    correction: int
    level: int

    @classmethod
    def of(cls, hierarchy: Hierarchy, n_voxels: int) -> Traffic:
        """Count what is moved.

        Args:
            hierarchy: The levels.
            n_voxels: V of the grid [–].
        """
        every: list[Piece] = []
        finest: list[Piece] = []
        for number in range(len(hierarchy.levels)):
            own = [piece for each in _passes(hierarchy, number) for piece in each]
            every += own
            finest += own if number == 0 else []
        top = hierarchy.levels[0]
        half = _half(top)
        colours = 2 if top.is_odd else 1
        # r·z; p; A p (of one colour through the other's lines); x, r and r·r
        vectors = colours * (2 + 3 + 4 + 6) * half + (0 if top.is_odd else 3 * half)
        # double: x twice read and once written, b, and the mask; halves: both ways
        correction = n_voxels * (3 * 8 + 8 + 1) + 2 * 2 * half
        # single: the answer zeroed; colour 0 taken out and put back
        correction += 2 * half + (2 * 2 * half if top.is_odd else 13 * half)
        return cls(
            _bytes(hierarchy, set(every)),
            _bytes(hierarchy, every),
            _bytes(hierarchy, finest),
            vectors,
            correction,
            2 * half,
        )

    def solve(self, cycles: int, corrections: int) -> int:
        """Bytes of a solve, every pass.

        Args:
            cycles: V-cycles [–].
            corrections: Rounds of iterative refinement [–].
        """
        return cycles * (self.cycle + self.vectors) + corrections * self.correction


def _half(level: Level) -> int:
    """Size of one colour of one array [byte]."""
    return int(np.prod(level.shape[1:])) * level.inverse.itemsize


def _bytes(hierarchy: Hierarchy, pieces: set[Piece] | list[Piece]) -> int:
    return sum(
        hierarchy.inverse.nbytes
        if name == "direct"
        else _half(hierarchy.levels[number])
        for name, number, _ in pieces
    )


def _passes(hierarchy: Hierarchy, number: int) -> Iterator[Pass]:
    """What every pass of one level of `cycle` reads and writes."""
    level, last = hierarchy.levels[number], len(hierarchy.levels) - 1
    b, x, residual = (
        [(name, number, colour) for colour in range(2)] for name in ("b", "x", "r")
    )
    if number == last:
        yield (("direct", number, 0), *b, *x)
        return
    # the finest level is called with a right-hand side on colour 1 alone
    loaded = (True, True) if number or level.is_odd else (False, True)
    if level.is_odd:
        yield tuple(x)
    uneven = level.R.ndim > 1
    inverse = [("inverse", number, colour) for colour in range(2)]
    along = [(("R", number, c),) if uneven else () for c in range(2)]
    across: Pass = (
        tuple((name, number, c) for name in "TZ" for c in range(2)) if uneven else ()
    )

    def alone(colour: int) -> Pass:
        load = (b[colour],) if loaded[colour] else ()
        return (*load, inverse[colour], *along[colour], x[colour])

    def sweep(colour: int) -> Pass:
        return (*alone(colour), *across, x[1 - colour])

    couple: Pass = (x[0], *across, residual[1])
    if not uneven:
        couple = (*couple, inverse[1])
    yield alone(1)
    yield sweep(0)
    yield couple
    if number:
        yield sweep(1)
        yield sweep(0)
        yield (*couple, residual[1])  # what was there is read as well
    below = [("b", number + 1, colour) for colour in range(2)]
    yield (residual[1], *_weights(level, number), *below)
    above = [("x", number + 1, colour) for colour in range(2)]
    yield (*above, *_weights(level, number), x[1], x[1])
    for _ in range(2 if number else 1):
        yield sweep(0)
        yield sweep(1)


def _weights(level: Level, number: int) -> Pass:
    """Halves of the interpolation weights that a transfer reads, each once."""
    along_r, along_theta, along_z = level.flags
    used = [(w, 1) for w in (0, 1) if along_r]
    used += [(w, 0 if along_z else 1) for w in (2, 3) if along_theta]
    used += [(w, 1) for w in (4, 5) if along_z]
    # on the finest level all six are one array
    found = {(id(level.weights[w]), colour): w for w, colour in used}
    return tuple((f"w{w}", number, colour) for (_, colour), w in found.items())


@dataclass(frozen=True)
class Bandwidth:
    """How fast this machine copies, reads and writes counted [byte/s].

    Attributes:
        memory: Of an array beyond the last-level cache.
        level: Of one of the size of a level.
        memory_size: Size of the first array [byte].
        cache: The last-level cache as the system tells it; None where it does not
            [byte].
    """

    memory: float
    level: float
    memory_size: int
    cache: int | None = field(default=None)

    @classmethod
    def measure(cls, level_size: int, most: int | None = None) -> Bandwidth:
        """Copy arrays with numpy, on one core as the multigrid works.

        Args:
            level_size: Size of a level's array [byte].
            most: Largest array to copy; None for what the cache asks for [byte].
        """
        cache = last_level_cache()
        size = UNKNOWN_CACHE if cache is None else max(BEYOND * cache, 2**26)
        size = size if most is None else min(size, most)
        return cls(_copied(size), _copied(level_size), size, cache)


def _copied(size: int) -> float:
    """Bytes read and written per second by the fastest of several copies."""
    source = np.ones(size // 8)
    target = np.empty_like(source)
    target[:] = source  # pages are given out here
    least, begun = np.inf, time.perf_counter()
    for _ in range(COPIES):
        start = time.perf_counter()
        np.copyto(target, source)
        least = min(least, time.perf_counter() - start)
        if time.perf_counter() - begun > COPY_SECONDS:
            break
    return 2.0 * source.nbytes / least


def last_level_cache() -> int | None:
    """Size of the largest cache of the first core; None where it is not told [byte]."""
    units = {"K": 2**10, "M": 2**20, "G": 2**30}
    sizes = []
    for file in Path("/sys/devices/system/cpu/cpu0/cache").glob("index*/size"):
        try:
            text = file.read_text(encoding="ascii").strip()
            sizes.append(int(text[:-1]) * units[text[-1]])
        except (OSError, ValueError, KeyError, IndexError):
            continue
    return max(sizes, default=None)
