from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from ttus_opt.errors import InputError
from ttus_opt.functionals import Block, Functionals, Tail

Array = NDArray[np.float64]
V = 200


def random_block(rng: np.random.Generator, size: int = 12, height: int = 3) -> Block:
    voxels = np.sort(rng.choice(V, size, replace=False)).astype(np.int32)
    return Block(voxels, rng.normal(size=(size, height)))


def dense(block: Block) -> Array:
    rows = np.zeros((block.values.shape[1], V))
    rows[:, block.voxels] = block.values.T
    return rows


def phi(functionals: Functionals) -> Array:
    """Φ, column by column."""
    return np.array([functionals.of(e) for e in np.eye(V)]).T


def covered(functionals: Functionals, block: Block, resolved: int) -> Tail | None:
    """Resolve some of the block's voxels and leave the rest to a tail."""
    rest = functionals.unresolved(block.voxels)
    at = np.flatnonzero(rest)[:resolved]
    functionals.resolve(block.voxels[at])
    rest[at] = False
    return functionals.add_tail(block, rest) if rest.any() else None


def test_rows_are_sums_of_functionals_whatever_goes() -> None:
    rng = np.random.default_rng(0)
    functionals = Functionals(V)
    blocks = [random_block(rng) for _ in range(30)]
    tails = [covered(functionals, block, 4) for block in blocks]
    assert len(functionals.tails) > 10
    # more than there is room for at first
    assert len(functionals) > 64
    left = list(range(30))
    for gone in rng.permutation(30)[:20]:
        tail = tails[gone]
        if tail is not None:
            before = len(functionals)
            assert list(functionals.drop_tail(tail)) == sorted(tail.slots)[::-1]
            assert len(functionals) == before - 3
        left.remove(gone)
        whole = phi(functionals)
        for i in left:
            C = functionals.combination(blocks[i], tails[i], 1.0)
            assert np.allclose(C.values.T @ whole[C.slots], dense(blocks[i]))
    # no voxel is there twice
    single = [row for row in phi(functionals) if np.count_nonzero(row) == 1]
    assert np.linalg.matrix_rank(np.array(single)) == len(single)


def test_of_and_adjoint_are_adjoint() -> None:
    rng = np.random.default_rng(1)
    functionals = Functionals(V)
    for _ in range(8):
        covered(functionals, random_block(rng), 3)
    x, u = rng.normal(size=V), rng.normal(size=len(functionals))
    assert functionals.of(x) @ u == pytest.approx(x @ functionals.adjoint(u))
    assert np.allclose(functionals.adjoint(u), phi(functionals).T @ u)


def test_a_faded_block_is_so_many_times_its_tail() -> None:
    rng = np.random.default_rng(2)
    functionals, block = Functionals(V), random_block(rng)
    tail = covered(functionals, block, 5)
    assert tail is not None
    half = Block(block.voxels, 0.5 * block.values)
    C = functionals.combination(half, tail, 0.5)
    assert np.allclose(C.values.T @ phi(functionals)[C.slots], 0.5 * dense(block))


def test_voxels_must_be_there() -> None:
    with pytest.raises(InputError, match="voxels must lie in 0 to 199"):
        Functionals(V).unresolved(np.array([3, V], dtype=np.int32))
