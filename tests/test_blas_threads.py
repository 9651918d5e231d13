"""One thread for small matrices, and as many as before afterwards."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from ttus_opt.blas_threads import libraries, one_blas_thread


def threads() -> list[int]:
    return [library.threads() for library in libraries()]


@pytest.fixture(autouse=True)
def two_threads() -> Iterator[None]:
    before = threads()
    for library in libraries():
        library.use(2)
    if set(threads()) != {2}:
        pytest.skip("numpy and scipy with other libraries, or one processor")
    yield
    for library, count in zip(libraries(), before, strict=True):
        library.use(count)


def test_one_thread_within_and_those_before_after() -> None:
    with one_blas_thread():
        assert set(threads()) == {1}
        with one_blas_thread():
            assert set(threads()) == {1}
        assert set(threads()) == {1}  # the outer one still wants it
    assert set(threads()) == {2}


def test_a_function_that_fails_restores_them() -> None:
    @one_blas_thread()
    def fail() -> None:
        assert set(threads()) == {1}
        raise ZeroDivisionError

    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            fail()
        assert set(threads()) == {2}
