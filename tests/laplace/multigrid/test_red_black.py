"""The red-black order, node by node."""

import itertools

import numpy as np
import pytest

from ttus_opt.laplace.multigrid.red_black import LANES, Layout

SHAPES = [(3, 6, 5), (4, 6, 4), (3, 5, 6), (2, 7, 3)]


@pytest.mark.parametrize("shape", SHAPES)
def test_every_node_has_a_place_of_its_colour(shape):
    layout = Layout.of(shape)
    n_r, n_theta, n_z = shape
    values = 1.0 + np.arange(np.prod(shape), dtype=np.float32).reshape(shape)
    stored = layout.split(values)
    assert stored.shape == layout.stored_shape == (2, n_r, layout.width)
    assert layout.width % LANES == 0 and layout.pitch % 2 == 1
    last = n_z if n_z % 2 else n_z - 1  # of an even number the last has no own place
    nodes = list(itertools.product(range(n_r), range(n_theta), range(last)))
    places = layout.places(tuple(np.array(nodes).T))
    np.testing.assert_array_equal(
        stored.reshape(-1)[places], [values[n] for n in nodes]
    )
    assert len(np.unique(places)) == len(nodes)


@pytest.mark.parametrize("shape", SHAPES)
def test_neighbours_have_the_other_colour_and_the_circle_is_closed(shape):
    layout = Layout.of(shape)
    values = 1.0 + np.arange(np.prod(shape), dtype=np.float32).reshape(shape)
    stored = layout.split(values)
    _, n_theta, n_z = shape
    for i, j, k in itertools.product((0, 1), range(n_theta), range(1, n_z - 2)):
        m = (j + 1) * layout.pitch + k
        for step, node in (
            (1, (i, j, k + 1)),
            (-1, (i, j, k - 1)),
            (layout.pitch, (i, (j + 1) % n_theta, k)),
            (-layout.pitch, (i, (j - 1) % n_theta, k)),
        ):
            at = m + step
            assert at % 2 != m % 2
            assert stored[at % 2, i, at // 2] == values[node]
