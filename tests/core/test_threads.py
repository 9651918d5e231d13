"""Work side by side, also where a system does not say which cores there are."""

import os
import signal
import threading
import time

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import ttus_opt as tt
from tests.kit import refuses
from ttus_opt import example
from ttus_opt.core.threads import (
    in_parts,
    one_blas_thread,
    parts_of,
    side_by_side,
    usable_cores,
)
from ttus_opt.fitting.uncertainty import covariance_posterior, posterior
from ttus_opt.problem import compression
from ttus_opt.solvers import covariance


def test_results_stand_in_the_order_of_the_things():
    assert side_by_side(lambda a, b: a - b, range(9), range(0, 90, 10)) == [
        a - 10 * a for a in range(9)
    ]
    assert side_by_side(str, []) == []


def test_an_error_reaches_the_caller():
    refuses(ZeroDivisionError, "", side_by_side, lambda a: 1 / a, [1, 0])


def test_cores_are_those_of_this_process(monkeypatch):
    own = {0: {2, 5, 7}}  # by the number of a process, 0 for this one
    monkeypatch.setattr(os, "sched_getaffinity", own.__getitem__, raising=False)
    assert usable_cores() == 3


@pytest.mark.parametrize(("told", "cores"), [(3, 3), (None, 1)])
def test_systems_without_affinity(told, cores, monkeypatch):
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: told)
    assert usable_cores() == cores


def test_as_many_at_a_time_as_there_are_cores(monkeypatch):
    monkeypatch.setattr("ttus_opt.core.threads.usable_cores", lambda: 2)
    both = threading.Barrier(2, timeout=20.0)
    side_by_side(lambda _: both.wait(), range(2))


def test_parts_are_done_at_the_same_time_each_once():
    together, done = threading.Barrier(3, timeout=20.0), []

    def work(part):
        together.wait()
        done.append(part)

    in_parts(work, 3)
    assert sorted(done) == [(0, 3), (1, 3), (2, 3)]
    in_parts(done.append, 1)
    assert done[3:] == [(0, 1)]


@pytest.mark.parametrize("failing", [0, 1])
def test_a_part_that_fails_reaches_the_caller_when_the_others_are_done(failing):
    start, done = threading.Barrier(2, timeout=20.0), []

    def work(part):
        start.wait()
        if part[0] == failing:
            raise ZeroDivisionError
        time.sleep(0.05)
        done.append(part)

    refuses(ZeroDivisionError, "", in_parts, work, 2)
    assert done == [(1 - failing, 2)]


def test_what_is_shared(monkeypatch):
    """Large things, by all cores but not too many, unless these have work already."""
    monkeypatch.setattr("ttus_opt.core.threads.usable_cores", lambda: 3)
    assert (parts_of(9, 10), parts_of(10, 10)) == (1, 3)
    assert side_by_side(lambda size: parts_of(size, 10), [10, 20]) == [1, 1]
    shares = []
    in_parts(lambda part: shares.append((part[0], parts_of(10, 10))), 2)
    assert sorted(shares) == [(0, 3), (1, 1)]
    monkeypatch.setattr("ttus_opt.core.threads.usable_cores", lambda: 64)
    assert parts_of(10, 10) == 8


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_parts_in_a_forked_process():
    """Which has none of the threads that its parent kept."""
    in_parts(lambda part: None, 2)
    child = os.fork()
    if child == 0:
        in_parts(lambda part: None, 2)
        os._exit(0)
    ended = 0
    for _ in range(200):
        if ended := os.waitpid(child, os.WNOHANG)[0]:
            break
        time.sleep(0.05)
    if not ended:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    assert ended


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
        refuses(ZeroDivisionError, "", fail)
        assert threads() == {2}


@pytest.mark.filterwarnings("ignore:the recordings tell hardly more than one place")
def test_a_fit_its_uncertainty_and_many_rows_are_done_by_one(monkeypatch):
    """By two that wait for each other on a busy machine they took 2 to 100 times."""
    surface = tt.Surface.load(example.path("surface.nc"))
    path = tt.read_trajectory(example.path("press_fit.csv"))
    voxmap = tt.Voxmap.from_surface(surface, shape=(10, 24, 12), r_inner=0.05)
    scene = tt.Scene.assemble(voxmap, tt.PointShell.from_spec(example.PROBE), path)
    seen = {}

    def watched(module, name):
        original = getattr(module, name)

        def watching(*given, **named):
            seen.setdefault((module.__name__, name), set()).update(threads())
            return original(*given, **named)

        monkeypatch.setattr(module, name, watching)

    for module, name in (
        (compression, "_decomposed"),
        (covariance, "conditioned"),
        (covariance, "to_residual"),
        (covariance_posterior, "conditioned"),
        (posterior.Posterior, "draw"),
        (posterior.Posterior, "covariance"),
    ):
        watched(module, name)
    compression.compressed_rows(scene.N, scene.f)
    solution = tt.fit(scene, "depth_map", solver="covariance")
    stated = tt.uncertainty(solution, scene)
    stated.std(path)
    stated.draws(2)
    stated.potential_std()
    assert len(seen) == 6
    assert all(one == {1} for one in seen.values()), seen
    assert threads() == {2}
