"""The tab that colours the skin, and its legend."""

from __future__ import annotations

import threading
from collections.abc import Callable
from html import escape
from typing import TYPE_CHECKING, Any

from ttus_opt.core.errors import InputError
from ttus_opt.viewer import colouring
from ttus_opt.viewer.colour_map import node_colours, skin_legend
from ttus_opt.viewer.colouring import Colouring
from ttus_opt.viewer.looks import small

if TYPE_CHECKING:
    from ttus_opt.fitting.uncertainty.field_uncertainty import Uncertainty
    from ttus_opt.viewer.page import Page

    #: The uncertainty of a fit, or what gives it when somebody looks
    Stated = Uncertainty | Callable[[], Uncertainty]

NEEDS_FIT = (
    "where to press next follows from a fit and its recordings: ttus-opt next-press "
    "names the places, tt.view(..., uncertainty=tt.uncertainty(solution, scene)) "
    "shows them"
)


class SkinTab:
    """Chooses what the skin shows; each colouring is computed once.

    Args:
        page: The page.
        legend: Holds the legend.
        stated: Uncertainty of the first field's fit, for where to press next.
    """

    def __init__(self, page: Page, legend: Any, stated: Stated | None) -> None:
        self._page, self._legend, self._stated = page, legend, stated
        self._known: dict[str, list[Colouring]] = {}
        self._painting, self._stating = threading.Lock(), threading.Lock()
        self._ways: dict[str, Callable[[], list[Colouring]]] = {
            "Stiffness": self._stiffness,
            "Uncertainty": self._uncertainty,
            "Seen": self._seen,
            "Next press": self._next,
        }
        if page.state.shell is None:
            del self._ways["Stiffness"], self._ways["Next press"]
            self._ways = {"Seen": self._seen} | self._ways
        gui = page.server.gui
        self.choice = gui.add_dropdown("colour", tuple(self._ways))
        page.by_hand(self.choice, self.show)
        self.show(self.choice.value)

    def show(self, name: str) -> None:
        """Colour the skin, soon; one that takes long holds up no other."""
        self._shown = name
        self._legend.content = small("computing …")
        self._page.jobs.post(f"colours {name}", lambda: self._paint(name))

    def forget(self) -> None:
        """Colour anew, as a field was replaced; the legend stays: nothing jumps."""
        self._known, name = {}, self._shown  # old ones may still be computed
        self._page.jobs.post(f"colours {name}", lambda: self._paint(name))

    def colourings(self, name: str) -> list[Colouring]:
        """A colouring of every field.

        Raises:
            InputError: What it needs is not there.
        """
        known = self._known
        if name not in known:
            known[name] = self._ways[name]()
        return known[name]

    def _paint(self, name: str) -> None:
        found: list[Colouring] = []
        try:
            found = self.colourings(name)
        except InputError as error:
            told = small(escape(str(error)))
        except Exception:
            told = small("not computed")
            raise
        else:
            lows, highs = zip(*(one.span for one in found), strict=True)
            span = min(lows), max(highs)
            told = skin_legend(found[0], span)
        finally:
            with self._painting:
                if name == self._shown:  # no other was chosen meanwhile
                    for k, nodes in enumerate(self._page.nodes):
                        if found:
                            one = found[k]
                            nodes.colour(node_colours(one, span), one.marks)
                        else:  # no colours that the legend does not explain
                            nodes.blank()
                    self._legend.content = told

    def _stiffness(self) -> list[Colouring]:
        state = self._page.state
        return [
            colouring.stiffness(
                field, renderer, state.probe, state.hold, self._page.nodes[0].skin
            )
            for field, renderer in zip(state.fields, state.renderers(), strict=True)
        ]

    def _uncertainty(self) -> list[Colouring]:
        skin, (first, *rest) = self._page.nodes[0].skin, self._page.state.fields
        stated = self._statement() if first.uncertainty is None else None
        return [
            colouring.uncertainty(first, skin, stated),
            *(colouring.uncertainty(one, skin) for one in rest),
        ]

    def _seen(self) -> list[Colouring]:
        skin = self._page.nodes[0].skin
        return [colouring.seen(one, skin) for one in self._page.state.fields]

    def _next(self) -> list[Colouring]:
        stated = self._statement()
        if stated is None:
            raise InputError(NEEDS_FIT)
        found = colouring.next_presses(stated, self._page.nodes[0].skin)
        return [found] * len(self._page.nodes)

    def _statement(self) -> Uncertainty | None:
        """The fit's uncertainty, computed when it is first looked at."""
        with self._stating:  # by two colourings
            if callable(self._stated):
                self._stated = self._stated()
            return self._stated
