"""The process that compiles the multigrid while another reads its data."""

import subprocess

import pytest

from ttus_opt.laplace.multigrid import ahead
from ttus_opt.laplace.multigrid.ahead import LAST


def test_what_it_solves_compiles_the_solver():
    ahead.compile_multigrid()
    for function in LAST:
        assert function.signatures
        assert ahead.is_cached(function)


@pytest.fixture
def done(monkeypatch):
    """What is done with the other process, which is a stand-in."""
    events: list[str] = []

    class Helper:
        def __init__(self, command, **_):
            assert command[1:] == ["-P", "-m", "ttus_opt.laplace.multigrid.ahead"]
            events.append("started")

        def terminate(self):
            events.append("ended")

        def wait(self):
            events.append("waited for")

    monkeypatch.setattr(subprocess, "Popen", Helper)
    return events


@pytest.mark.parametrize("is_cached", [True, False])
def test_a_process_is_started_only_when_there_is_something_to_do(
    is_cached, monkeypatch, done
):
    monkeypatch.setattr(ahead, "is_cached", lambda _: is_cached)
    with pytest.raises(KeyError), ahead.compiling_ahead():
        raise KeyError("a mistake meanwhile")
    assert done == ([] if is_cached else ["started", "ended", "waited for"])
