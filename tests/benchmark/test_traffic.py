"""Bytes of a V-cycle against the arrays its kernels are in fact handed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.conftest import small_scene
from ttus_opt.benchmark.traffic import Bandwidth, Traffic, last_level_cache
from ttus_opt.multigrid import cycle
from ttus_opt.multigrid.hierarchy import Hierarchy, Workspace
from ttus_opt.multigrid.kernels import LevelIndex


def hierarchy(n_theta: int) -> Hierarchy:
    scene = small_scene("trilinear", shape=(12, n_theta, 16), n_poses=2, seed=0)
    return scene.laplace.multigrid.hierarchy


def seen(made: Hierarchy, monkeypatch: pytest.MonkeyPatch) -> int:
    """Bytes of one V-cycle, from the arguments its kernels are called with.

    Without the weights of interpolation.
    """
    counts: list[int] = []

    def colour(at: LevelIndex) -> int:
        return 4 * int(at.n_r * at.width)

    def swept(row: Any, fields: Any, work: Any, c: int, x: int, *rest: int) -> None:
        at = LevelIndex(*row)
        opposite, load = (int(start != at.zeros) for start in rest)
        links = at.is_tied + 4 * at.is_uneven * opposite
        counts.append((2 + opposite + load + links) * colour(at))

    def flowed(row: Any, fields: Any, work: Any, out: int, x: int, kept: float) -> None:
        at = LevelIndex(*row)
        coefficients = 4 if at.is_uneven else 1  # T and Z, or which nodes are free
        counts.append((2 + (kept != 0) + coefficients) * colour(at))

    def moved(at: LevelIndex, below: LevelIndex, times: int) -> None:
        counts.append(times * colour(at) + 2 * colour(below))

    def solved(at: LevelIndex, work: Any, places: Any, inverse: Any, _: bool) -> None:
        counts.append(4 * colour(at) + inverse.nbytes)

    replaced = {
        "sweep": swept,
        "flow": flowed,
        "restrict": lambda at, below, *_: moved(at, below, 1),
        "prolong": lambda at, below, *_: moved(at, below, 2),
        "fill": lambda work, out, value, count: counts.append(4 * int(count)),
        "_solve_coarsest": solved,
        "close_circle": lambda *_: None,
        "level_index": lambda row: LevelIndex(*row),
    }
    for name, called in replaced.items():
        monkeypatch.setattr(cycle, name, called)
    work = np.zeros(made.work_size, np.float32)
    bottom = (made.places, made.inverse)
    # compiled code would not call what is put in the kernels' place
    run = getattr(cycle.v_cycle, "py_func", cycle.v_cycle)
    run(made.table, made.fields, work, *bottom, 1, made.levels[0].is_odd)
    return sum(counts)


@pytest.mark.parametrize("n_theta", [32, 33])
def test_bytes_are_those_of_the_arrays_handed_over(
    n_theta: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = hierarchy(n_theta)
    assert len(made.levels) > 2
    counted = Traffic.of(made, 12 * n_theta * 16)
    without = seen(made, monkeypatch)
    # told by none of these arguments: two colours of weights per direction coarsened,
    # both ways; on the finest level all weights are one array of two colours
    weights = 0
    for number, level in enumerate(made.levels[:-1]):
        r, theta, z = level.flags
        halves = 2 * (r + theta + z) if number else 1 + (theta and z)
        weights += 2 * halves * level.inverse.nbytes // 2
    assert counted.cycle == without + weights
    assert counted.finest < counted.cycle


def test_once_is_no_more_than_there_is() -> None:
    made = hierarchy(32)
    counted = Traffic.of(made, 12 * 32 * 16)
    whole = made.memory_bytes + Workspace(made).memory_bytes
    assert 0.5 * whole < counted.once <= whole
    assert counted.once < counted.cycle
    assert counted.level == made.levels[0].inverse.nbytes
    two = counted.solve(2, 1) - counted.solve(1, 1)
    assert two == counted.cycle + counted.vectors


def test_bandwidth_is_measured() -> None:
    found = Bandwidth.measure(2**16, 2**22)
    assert found.memory_size == 2**22
    # from a slow memory to a fast first-level cache
    for speed in (found.memory, found.level):
        assert 1e8 < speed < 1e13
    assert found.cache == last_level_cache()
    assert found.cache is None or found.cache > 2**15
