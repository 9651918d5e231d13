"""Work beside the page: the latest of a kind, none waits for another kind."""

import threading

from ttus_opt.core.errors import InputError
from ttus_opt.viewer.jobs import Jobs


def test_a_newer_job_replaces_one_that_has_not_begun():
    jobs, may_end, done = Jobs(print), threading.Event(), []
    begun = threading.Event()
    jobs.post("a", lambda: (begun.set(), may_end.wait(20.0), done.append(1)))
    assert begun.wait(20.0)
    for number in (2, 3):
        jobs.post("a", lambda number=number: done.append(number))
    assert not jobs.wait(0.01)
    may_end.set()
    assert jobs.wait(20.0)
    assert done == [1, 3]


def test_a_long_job_does_not_hold_another_kind_and_none_begins_after_the_end():
    jobs, may_end, done = Jobs(print), threading.Event(), threading.Event()
    jobs.post("long", lambda: may_end.wait(20.0))
    jobs.post("short", done.set)
    assert done.wait(20.0)
    jobs.post("long", done.clear)
    jobs.close(0.01)  # does not wait for what takes long
    jobs.post("late", done.clear)
    may_end.set()
    assert jobs.wait(20.0)
    assert done.is_set()


def test_what_fails_is_told_and_the_next_is_done():
    told = []
    jobs = Jobs(told.append)

    def fails(error):
        raise error

    for error in (InputError("no such field"), ValueError("odd")):
        jobs.post("a", lambda error=error: fails(error))
        assert jobs.wait(20.0)
    assert told == ["no such field", "a: ValueError: odd"]
