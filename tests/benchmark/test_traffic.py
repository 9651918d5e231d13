"""Bytes of a V-cycle against the arrays its kernels are in fact handed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.conftest import small_scene
from ttus_opt.benchmark.traffic import Bandwidth, Traffic, last_level_cache
from ttus_opt.multigrid import cycle as cycle_module
from ttus_opt.multigrid import kernels, line_smoother, transfer
from ttus_opt.multigrid.cycle import Hierarchy, Workspace, cycle
from ttus_opt.multigrid.kernels import Single


def hierarchy(n_theta: int) -> Hierarchy:
    scene = small_scene("trilinear", shape=(12, n_theta, 16), n_poses=2, seed=0)
    return scene.laplace.multigrid.hierarchy


def seen(made: Hierarchy, monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """Bytes of one V-cycle by kernel, from the arguments of its calls."""
    found: dict[str, int] = {}

    def size(a: Any, *, one_colour: bool = False) -> int:
        if a is None or a.ndim == 1:  # one number per layer is nothing
            return 0
        return int(a.nbytes) // (2 if one_colour and a.ndim == 3 else 1)

    def record(owner: Any, name: str, count: Callable[..., int]) -> None:
        held = getattr(owner, name)

        def called(*arguments: Any) -> None:
            found[name] = found.get(name, 0) + count(*arguments)
            held(*arguments)

        monkeypatch.setattr(owner, name, called)

    def swept(x: Single, *others: Any) -> int:
        *arrays, R, T, Z = others
        total = size(x, one_colour=True) + sum(map(size, arrays))
        return total + size(R, one_colour=True) + size(T) + size(Z)

    record(line_smoother, "sweep", lambda *a: swept(*a[:7]))
    record(line_smoother, "sweep_unloaded", lambda *a: swept(*a[:6]))
    record(
        line_smoother,
        "sweep_alone",
        lambda x, b, inv, R, *_: swept(x, b, inv, R, R0, R0),
    )
    R0 = np.zeros(1)

    def coupled(
        out: Any, x: Any, less: Any, inverse: Any, T: Any, Z: Any, _: Any
    ) -> int:
        own = size(out) * (2 if less else 1)
        return own + size(x) + (size(inverse) if T.ndim == 1 else 0) + size(T) + size(Z)

    record(kernels, "couple", coupled)
    record(transfer, "restrict", lambda out, r, *_: size(out) + size(r))
    record(transfer, "prolong", lambda out, x, *_: 2 * size(out) + size(x))
    record(kernels, "direct", lambda x, b0, b1, p, inv: size(x) * 2 + size(inv))
    # compiled code would not call what is put in the kernels' place
    for name in ("cycle_below", "direct"):
        monkeypatch.setattr(cycle_module, name, getattr(cycle_module, name).py_func)
    work = Workspace(made)
    for n, level in enumerate(made.levels):
        if (n or level.is_odd) and n < len(made.levels) - 1:
            found["fill"] = found.get("fill", 0) + work.x[n].nbytes
    b = work.b[0]
    b[:] = made.levels[0].inverse
    cycle(made, work, (b[0] if made.levels[0].is_odd else None, b[1]))
    return found


@pytest.mark.parametrize("n_theta", [32, 33])
def test_bytes_are_those_of_the_arrays_handed_over(
    n_theta: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = hierarchy(n_theta)
    assert len(made.levels) > 2
    counted = Traffic.of(made, 12 * n_theta * 16)
    without = sum(seen(made, monkeypatch).values())
    # told by none of these arguments: two halves of weights per direction coarsened,
    # both ways; on the finest level all weights are one array of two halves
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
