import multiprocessing
import time

import numpy as np
import pytest

from tests.kit import NumericalError, refuses
from ttus_opt.live.shared_arrays import SharedArray


def test_the_newest_values_are_read():
    with SharedArray(3) as here, SharedArray(3, here.name) as there:
        assert there.read()[1] == 0
        for k in range(1, 5):
            here.write(np.full(3, float(k)))
            values, count = there.read()
            np.testing.assert_array_equal(values, k)
            assert count == k


def test_a_torn_copy_is_refused():
    """The writer begins the second write after the one that is being copied."""
    with SharedArray(3) as one:
        one.write(np.ones(3))
        one._counters[0] = 3
        refuses(NumericalError, "faster", one.read)
        one._counters[0] = 2  # the other buffer: no harm
        np.testing.assert_array_equal(one.read()[0], 1.0)


def test_what_was_written_meanwhile_is_read_unless_it_is_gone():
    with SharedArray(2, depth=4) as one:
        for k in range(1, 4):
            one.write(np.full(2, float(k)))
        np.testing.assert_array_equal(one.since(0)[:, 0], [1, 2, 3])
        np.testing.assert_array_equal(one.since(2)[:, 1], [3])
        assert one.since(3).shape == (0, 2)
        for k in range(4, 8):
            one.write(np.full(2, float(k)))
        np.testing.assert_array_equal(one.since(3)[:, 0], [4, 5, 6, 7])
        refuses(NumericalError, "read too late: 5 were written", one.since, 2)


def _writes(name, size, seconds):
    with SharedArray(size, name) as shared:
        end, k = time.monotonic() + seconds, 0
        while time.monotonic() < end:
            k += 1
            shared.write(np.full(size, float(k)))
            time.sleep(0)


@pytest.mark.slow
def test_no_copy_is_ever_torn():
    size = 20_000
    with SharedArray(size) as shared:
        context = multiprocessing.get_context("spawn")
        writer = context.Process(target=_writes, args=(shared.name, size, 0.3))
        writer.start()
        read = 0
        while writer.is_alive():
            try:
                values, count = shared.read()
            except NumericalError:
                continue
            assert values.min() == values.max() == count
            read += count > 0
        writer.join()
        assert read > 5
