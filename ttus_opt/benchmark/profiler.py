"""Where the time of a run goes: a tree of spans, each with its own seconds.

Functions and methods are wrapped for the time of a run (`watched`); what is called
inside a wrapped one is its child. Only a span's own seconds are measured, those of
its children taken off; all else is sums of these, so that shares add up to one.
"""

from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

Path = tuple[str, ...]


@dataclass(frozen=True)
class Watch:
    """A function to be timed.

    Attributes:
        owner: Module or class that holds it; calls through other names are not seen.
        attribute: Its name there.
        span: What its time is called.
        aside: What it calls is a neighbour of its span, not a child: for algebra that
            is interleaved with the products it asks for.
        outside: No span of its own inside spans of this name.
        returns: What the time of the function that it returns is called; "" where it
            returns no function.
    """

    owner: Any
    attribute: str
    span: str
    aside: bool = False
    outside: str = ""
    returns: str = ""


@dataclass
class Node:
    """A span at its place in the tree.

    Attributes:
        path: Names from the root to this one.
        own: Seconds in it but not in its children [s].
        calls: How often it was entered [–].
        total: Seconds in it and all below [s].
    """

    path: Path
    own: float = 0.0
    calls: int = 0
    total: float = 0.0


@dataclass
class _Open:
    span: str
    aside: bool
    start: float
    nested: float = 0.0


@dataclass
class Profiler:
    """Spans of one thread."""

    _nodes: dict[Path, Node] = field(default_factory=dict)
    _open: list[_Open] = field(default_factory=list)

    @contextlib.contextmanager
    def span(self, name: str, *, aside: bool = False) -> Iterator[None]:
        """Time what is done inside.

        Args:
            name: Of the span.
            aside: As of `Watch`.
        """
        path = (*(o.span for o in self._open if not o.aside), name)
        node = self._nodes.setdefault(path, Node(path))
        current = _Open(name, aside, time.perf_counter())
        self._open.append(current)
        try:
            yield
        finally:
            elapsed = time.perf_counter() - current.start
            self._open.pop()
            node.own += elapsed - current.nested
            node.calls += 1
            if self._open:
                self._open[-1].nested += elapsed

    @contextlib.contextmanager
    def watched(self, watches: Sequence[Watch]) -> Iterator[None]:
        """Wrap functions, and put them back at the end.

        Raises:
            AttributeError: There is no such function any more.
        """
        before = [(w, _held(w.owner, w.attribute)) for w in watches]
        try:
            for watch, held in before:
                setattr(watch.owner, watch.attribute, self._wrapped(watch, held))
            yield
        finally:
            for watch, held in before:
                setattr(watch.owner, watch.attribute, held)

    def wrap(self, function: Callable[..., Any], watch: Watch) -> Callable[..., Any]:
        """The same function, timed."""

        @functools.wraps(function)
        def timed(*arguments: Any, **named: Any) -> Any:
            if watch.outside and any(o.span == watch.outside for o in self._open):
                return function(*arguments, **named)
            with self.span(watch.span, aside=watch.aside):
                result = function(*arguments, **named)
            if watch.returns:
                return self.wrap(result, replace(watch, span=watch.returns, returns=""))
            return result

        return timed

    def _wrapped(self, watch: Watch, held: Any) -> Any:
        if isinstance(held, classmethod):
            return classmethod(self.wrap(held.__func__, watch))
        return self.wrap(held, watch)

    def nodes(self) -> list[Node]:
        """All spans with their totals, a parent before its children.

        Children stand in the order in which they were first entered.
        """
        for node in self._nodes.values():
            node.total = 0.0
        for node in self._nodes.values():
            for depth in range(len(node.path)):
                self._nodes[node.path[: depth + 1]].total += node.own
        order = {path: n for n, path in enumerate(self._nodes)}
        key = functools.cache(
            lambda path: tuple(order[path[: d + 1]] for d in range(len(path)))
        )
        return sorted(self._nodes.values(), key=lambda node: key(node.path))


def _held(owner: Any, attribute: str) -> Any:
    """What an owner itself holds, a classmethod as such."""
    held = vars(owner).get(attribute)
    if held is None:
        raise AttributeError(f"{owner!r} has no {attribute!r} of its own to watch")
    return held
