"""What the parts of a page share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from ttus_opt.core.errors import TtusError
from ttus_opt.viewer.jobs import Jobs
from ttus_opt.viewer.patient_nodes import PatientNodes
from ttus_opt.viewer.skin import SkinMesh
from ttus_opt.viewer.state import ViewState

if TYPE_CHECKING:
    import viser


@dataclass(frozen=True)
class Stage:
    """One page: its server, what it shows, and work beside it.

    Attributes:
        server: Of the page.
        state: What is shown.
        names: Of the fields.
        nodes: Patient and probe of every field.
        jobs: Work beside the page.
        tell: Shows a line on every page.
    """

    server: viser.ViserServer = field(repr=False)
    state: ViewState = field(repr=False)
    names: Sequence[str]
    nodes: Sequence[PatientNodes] = field(repr=False)
    jobs: Jobs = field(repr=False)
    tell: Callable[[str], None] = field(repr=False)

    @property
    def skin(self) -> SkinMesh:
        """Nodes of the skin."""
        return self.nodes[0].skin


def by_hand(
    handle: Any, act: Callable[[Any], object], tell: Callable[[str], None]
) -> None:
    """Act when somebody changes an input of a page, not when the viewer itself does.

    Args:
        handle: The input.
        act: Called with its value, in the order of the changes.
        tell: Called with the error where that is refused.
    """

    async def changed(event: Any) -> None:
        if event.client is None:
            return
        try:
            act(event.target.value)
        except TtusError as error:
            tell(str(error))

    handle.on_update(changed)
