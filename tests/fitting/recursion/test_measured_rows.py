import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ttus_opt.fitting.recursion.measured_rows import ROOM, Block, MeasuredRows

V = 30


def random_rows(counts, height, rng):
    """Rows with so many voxels per block, and the same as a dense matrix."""
    rows, dense = MeasuredRows(V, height), []
    for count in counts:
        voxels = np.sort(rng.permutation(V)[:count]).astype(np.int32)
        values = rng.normal(size=(count, height))
        rows.append(Block(voxels, values))
        part = np.zeros((height, V))
        part[:, voxels] = values.T
        dense.append(part)
    return rows, np.concatenate([*dense, np.zeros((0, V))])


@given(
    counts=st.lists(st.integers(0, V), max_size=6),
    height=st.sampled_from([3, 6]),
    factor=st.floats(0.1, 2.0),
    seed=st.integers(0, 2**32 - 1),
    data=st.data(),
)
@settings(max_examples=50)
def test_equals_a_dense_matrix(counts, height, factor, seed, data):
    rng = np.random.default_rng(seed)
    rows, dense = random_rows(counts, height, rng)
    kept = (
        sorted(data.draw(st.sets(st.sampled_from(range(len(counts))))))
        if (counts)
        else []
    )
    for step in ("whole", "kept"):
        if step == "kept":
            rows.keep(np.array(kept, dtype=np.int64))
            rows.scale(factor)
            blocks = dense.reshape(-1, height, V)[kept]
            dense = factor * blocks.reshape(-1, V)
            more, extra = random_rows([4], height, np.random.default_rng(seed))
            assert len(more) == 1
            voxels = np.flatnonzero(extra.any(axis=0)).astype(np.int32)
            rows.append(Block(voxels, extra[:, voxels].T))
            dense = np.concatenate([dense, extra])
        assert len(rows) * height == len(dense)
        x, y = rng.normal(size=V), rng.normal(size=len(dense))
        assert np.allclose(rows.times(x), dense @ x, atol=1e-12)
        assert np.allclose(rows.adjoint(y), dense.T @ y, atol=1e-12)
        for i in range(0, len(dense), 2):
            own, values = rows.row(i)
            assert np.allclose(values @ x[own], dense[i] @ x, atol=1e-12)


def test_grows_beyond_its_first_room():
    rng = np.random.default_rng(0)
    rows, dense = random_rows([V] * (2 * ROOM // V + 3), 3, rng)
    x = rng.normal(size=V)
    assert np.allclose(rows.times(x), dense @ x, atol=1e-12)
    entries = len(dense) // 3 * V
    assert rows.memory_bytes <= 2 * entries * (4 + 3 * 8) + 8 * (len(rows) + 1)
