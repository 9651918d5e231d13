"""A viewer that serves its page until it is closed: ``tt.view``."""

from __future__ import annotations

import atexit
import threading
import time
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING

from ttus_opt.core.arguments import expect
from ttus_opt.core.closing import Closing
from ttus_opt.core.errors import InputError, TtusError
from ttus_opt.probe.mesh import TriangleMesh
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.viewer.guarded_server import PORT, Served, guarded_server
from ttus_opt.viewer.page import Page
from ttus_opt.viewer.state import ViewState
from ttus_opt.voxmap.field import PotentialField

if TYPE_CHECKING:
    from ttus_opt.viewer.skin_tab import Stated

#: Time between frames while something moves, and while nothing does [s]
MOVING, IDLE = 1.0 / 60.0, 1.0 / 20.0

#: Time between updates of numbers and plots [s]
WRITING = 0.1

#: What pages say at the end
ENDED = "the viewer has ended: this page no longer changes"

#: Height of a page in a notebook [px]
HEIGHT = 640


class Viewer(Closing):
    """A page about one or two fields, open while this lives.

    Attributes:
        state: What is shown; poses and fields may be given to it from any thread.
        url: Link to the page. Only this machine can open it.

    Args:
        state: What is shown.
        names: Of the fields.
        mesh: The probe's own mesh, probe frame; None for the hull of its points.
        uncertainty: Of the first field's fit, for where to press next.
        port: Where to serve; the next free one if it is taken.
        served: Pages that are open already, in place of a port.

    Raises:
        MissingPackageError: viser is not installed.
    """

    def __init__(
        self,
        state: ViewState,
        names: Sequence[str],
        *,
        mesh: TriangleMesh | None = None,
        uncertainty: Stated | None = None,
        port: int = PORT,
        served: Served | None = None,
    ) -> None:
        self.state = state
        self._served = served or guarded_server(port)
        self.url = self._served.url
        with self._served.server.atomic():  # drawn once, not part by part
            self.page = Page(self._served, state, names, mesh, uncertainty)
        self._closing = threading.Event()
        self._drawn = state.touches
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        atexit.register(self.close)  # before viser's own end of a forgotten server

    def update(self, field: PotentialField, which: int = 0) -> None:
        """Show another field of the same patient in place of one.

        Raises:
            InputError: A field of another patient.
        """
        self.state.update(field, which)
        self.page.skin.forget()
        self.page.section.show()

    def wait(self) -> None:
        """Serve until `close`, or an interrupt."""
        while not self._closing.wait(3600.0):
            pass

    def close(self) -> None:
        """End the page; open browsers keep what they show, and say so."""
        if self._closing.is_set():
            return
        self._closing.set()
        atexit.unregister(self.close)
        self._thread.join(timeout=5.0)
        self.page.jobs.close()
        self._served.end(ENDED)

    def __repr__(self) -> str:
        return f"Viewer({self.url})"

    def _repr_html_(self) -> str:
        url = escape(self.url)
        return (
            f'<iframe src="{url}" width="100%" height="{HEIGHT}" '
            f'style="border:1px solid #ccc;border-radius:6px"></iframe>'
            f'<div><a href="{url}" target="_blank">open in a window</a></div>'
        )

    def _run(self) -> None:
        """Move and draw, until closed; an error is told, and it goes on."""
        last, written, told = time.monotonic(), 0.0, ""
        changed = unwritten = True
        while not self._closing.wait(MOVING if changed else IDLE):
            now = time.monotonic()
            seconds, last = now - last, now
            try:
                changed = self._step(seconds, now)
                unwritten |= changed
                if unwritten and now - written > WRITING:
                    self.page.write()
                    written, unwritten = now, False
                told = ""
            except Exception as error:
                known = isinstance(error, TtusError)
                line = str(error) if known else f"{type(error).__name__}: {error}"
                if line != told:
                    self.page.tell(line)
                told, changed = line, False

    def _step(self, seconds: float, now: float) -> bool:
        """One frame; whether anything changed."""
        page = self.page
        if page.recording is not None:
            page.recording.play(seconds)
        self.state.advance(seconds)
        touches = self.state.touches
        changed = touches is not self._drawn
        if changed:
            page.move()
            self._drawn = touches
            if page.probe is not None:
                page.probe.add_point(now)
        return changed


def view(
    field: PotentialField | Sequence[PotentialField],
    shell: PointShell | None = None,
    trajectory: Trajectory | None = None,
    *,
    names: Sequence[str] = (),
    mesh: TriangleMesh | None = None,
    uncertainty: Stated | None = None,
    port: int = PORT,
    served: Served | None = None,
) -> Viewer:
    """Open a page that shows a field and lets one press it.

    It serves in the background until `Viewer.close`; only this machine can open it,
    by the link in `Viewer.url`. In a notebook the page is the cell's output.

    Args:
        field: The field, or two of one patient to compare with one probe.
        shell: The probe. By default the one in the field's provenance, if that is an
            ellipsoid, a sphere or a box; without one the page only shows.
        trajectory: Recordings to show, in the patient's frame.
        names: Of the fields.
        mesh: The probe's own mesh, probe frame; by default the hull of its points.
        uncertainty: Of the first field's fit (`ttus_opt.uncertainty`), for where to
            press next; or a function that gives it, called when somebody looks.
        port: Where to serve; the next free one if it is taken.
        served: Pages that are open already (`guarded_server`), in place of a port.

    Raises:
        MissingPackageError: viser is not installed.
        InputError: No field, or more than two, or of different patients.
    """
    fields = [field] if isinstance(field, PotentialField) else list(field)
    for one in fields:
        expect(one, PotentialField, "the field")
    if shell is None and fields:
        shell = probe_of(fields[0])
    state = ViewState(fields, shell, trajectory)
    named = list(names) or ["felt", "other"][: len(fields)]
    if len(named) != len(fields):
        raise InputError(f"{len(fields)} fields need as many names, got {len(named)}")
    return Viewer(
        *(state, named),
        mesh=mesh,
        uncertainty=uncertainty,
        port=port,
        served=served,
    )


def probe_of(field: PotentialField) -> PointShell | None:
    """The probe that a field was fitted with, where its provenance describes it."""
    spec = field.provenance.get("probe", "")
    if spec.partition(":")[0] not in ("ellipsoid", "sphere", "box"):
        return None
    return PointShell.from_spec(spec)
