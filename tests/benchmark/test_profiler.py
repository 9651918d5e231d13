"""The tree of spans by a clock that only moves when told to."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from ttus_opt.benchmark import profiler as module
from ttus_opt.benchmark.profiler import Profiler, Watch


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(module.time, "perf_counter", made)
    return made


def told(profiler: Profiler) -> dict[str, tuple[float, float, int]]:
    return {"/".join(n.path): (n.own, n.total, n.calls) for n in profiler.nodes()}


def test_own_and_total_by_hand(clock: Clock) -> None:
    profiler = Profiler()
    with profiler.span("root"):
        clock.now += 1.0
        for _ in range(2):
            with profiler.span("a"):
                clock.now += 2.0
                with profiler.span("b"):
                    clock.now += 4.0
        with profiler.span("b"):
            clock.now += 8.0
    assert told(profiler) == {
        "root": (1.0, 21.0, 1),
        "root/a": (4.0, 12.0, 2),
        "root/a/b": (8.0, 8.0, 2),
        "root/b": (8.0, 8.0, 1),
    }
    assert [n.path[-1] for n in profiler.nodes()] == ["root", "a", "b", "b"]
    assert told(profiler)["root"][1] == 21.0  # asked again, the same


def test_what_an_aside_calls_stands_beside_it(clock: Clock) -> None:
    profiler = Profiler()
    with profiler.span("root"), profiler.span("algebra", aside=True):
        clock.now += 1.0
        with profiler.span("product"):
            clock.now += 2.0
        clock.now += 4.0
    assert told(profiler) == {
        "root": (0.0, 7.0, 1),
        "root/algebra": (5.0, 5.0, 1),
        "root/product": (2.0, 2.0, 1),
    }


def test_an_exception_ends_its_spans(clock: Clock) -> None:
    profiler = Profiler()
    with pytest.raises(KeyError), profiler.span("root"), profiler.span("a"):
        clock.now += 3.0
        raise KeyError
    with profiler.span("other"):
        pass
    assert told(profiler) == {
        "root": (0.0, 3.0, 1),
        "root/a": (3.0, 3.0, 1),
        "other": (0.0, 0.0, 1),
    }


def test_functions_are_wrapped_and_put_back(clock: Clock) -> None:
    class Thing:
        def work(self, seconds: float) -> float:
            clock.now += seconds
            return seconds

        def outer(self) -> float:
            return self.work(1.0)

        @classmethod
        def made(cls) -> Thing:
            clock.now += 5.0
            return cls()

    def maker() -> object:
        clock.now += 1.0
        return lambda: Thing().work(7.0)

    place = SimpleNamespace(maker=maker)
    before = dict(vars(Thing))
    profiler = Profiler()
    watches = [
        Watch(Thing, "work", "work", outside="outer"),
        Watch(Thing, "outer", "outer"),
        Watch(Thing, "made", "made"),
        Watch(place, "maker", "maker", returns="returned"),
    ]
    with profiler.watched(watches):
        thing = Thing.made()
        assert thing.work(2.0) == 2.0
        thing.outer()
        place.maker()()
    assert told(profiler) == {
        "made": (5.0, 5.0, 1),
        "work": (2.0, 2.0, 1),
        "outer": (1.0, 1.0, 1),
        "maker": (1.0, 1.0, 1),
        "returned": (0.0, 7.0, 1),
        "returned/work": (7.0, 7.0, 1),
    }
    assert dict(vars(Thing)) == before
    assert place.maker is maker


def test_what_is_gone_is_told_before_anything_is_wrapped() -> None:
    place = SimpleNamespace(here=len)
    watches = [Watch(place, "here", "here"), Watch(place, "gone", "gone")]
    with pytest.raises(AttributeError, match="'gone'"), Profiler().watched(watches):
        pass
    assert place.here is len
