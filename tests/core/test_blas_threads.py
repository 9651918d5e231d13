"""One thread for small matrices, and as many as before afterwards."""

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from ttus_opt.core.blas_threads import one_blas_thread


def threads():
    """Of numpy's and scipy's libraries; those that solvers bring are their own."""
    return {
        one["num_threads"]
        for one in threadpool_info()
        if one["user_api"] == "blas"
        and ("numpy" in one["filepath"] or "scipy" in one["filepath"])
    }


@pytest.fixture(autouse=True)
def two_threads():
    with threadpool_limits(limits=2, user_api="blas"):
        if threads() != {2}:
            pytest.skip("one processor, or a BLAS without threads")
        yield


def test_one_thread_within_and_those_before_after():
    with one_blas_thread():
        assert threads() == {1}
        with one_blas_thread():
            assert threads() == {1}
        assert threads() == {1}  # the outer one still wants it
    assert threads() == {2}


def test_a_function_that_fails_restores_them():
    @one_blas_thread()
    def fail():
        assert threads() == {1}
        raise ZeroDivisionError

    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            fail()
        assert threads() == {2}
