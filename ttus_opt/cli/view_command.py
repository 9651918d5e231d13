"""``ttus-opt view``: a field in a page of the browser, with a probe to press it."""

from __future__ import annotations

import contextlib
import gc
import os
import sys
import webbrowser
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ttus_opt.cli.console import Stages, tell
from ttus_opt.cli.recording_options import ProbeOptions, RecordingOptions
from ttus_opt.cli.sources import probe_for
from ttus_opt.core import io
from ttus_opt.core.errors import InputError
from ttus_opt.core.interrupts import ended_at_once

if TYPE_CHECKING:
    from ttus_opt.viewer.guarded_server import Served
    from ttus_opt.viewer.viewer import Viewer
    from ttus_opt.voxmap.field import PotentialField

#: Grid of the example's fit, a coarse one: it is fitted while one waits
EXAMPLE_SHAPE = (24, 72, 30)

#: Recordings of the example
EXAMPLE_FITTED, EXAMPLE_SHOWN = ("press_fit", "sweep_fit"), ("press_test",)


@dataclass(frozen=True)
class ShownProbe(ProbeOptions):
    """The probe, which a field may know.

    Attributes:
        probe: ellipsoid:a,b,c (semi-axes), sphere:r, box:a,b,c (edges) in metres, or a
            mesh file (STL, PLY, OBJ). By default the one that the field was fitted
            with, if that is none of the last.
    """

    probe: str | None = None  # type: ignore[assignment]


@dataclass(frozen=True)
class ShownRecordings(RecordingOptions):
    """The same options, none of them needed."""

    trajectory: Annotated[list[Path], typer.Option(metavar="PATH")] = ()  # type: ignore[assignment]


def view(
    field: Annotated[Path | None, typer.Argument()] = None,
    compare: Path | None = None,
    example: bool = False,
    port: int = 8050,
    no_browser: bool = False,
    *,
    tool: ShownProbe,
    recordings: ShownRecordings,
) -> None:
    """Show a field in the browser, and press it with the probe's mesh.

    The page shows the skin, coloured by stiffness, uncertainty, what the scan saw or
    where to press next; sections of the field; the recordings, felt against measured;
    and force and torque of the probe that is dragged over it. Only this machine can
    open it, by the link that is printed. Ctrl-C ends it.

    Args:
        compare: Another field file of the same patient, beside the first.
        example: Fit the bundled example and show it.

    Example:
        ttus-opt view field.nc --trajectory press.csv
    """
    from ttus_opt.viewer.guarded_server import guarded_server

    if (field is None) != example:
        raise InputError("give either a field file or --example")
    if example and compare is not None:
        raise InputError("--compare needs a field file, not --example")
    files = [file for file in (field, compare) if file is not None]
    for file in files:
        io.existing_file(file, "field")
    served = guarded_server(port)  # a browser begins while the rest is read
    tell(
        {"url": served.url},
        served.url,
        "open this link on this machine; Ctrl-C ends it",
    )
    sys.stdout.flush()
    if not no_browser:
        open_browser(served.url)
    try:
        # packages that load take an interrupt for their own
        with ended_at_once(), _uncollected():
            viewer = _viewer(served, files, tool, recordings)
    except Exception as error:
        served.end(f"nothing to show: {error}")
        raise
    with viewer:
        try:
            viewer.wait()
        except KeyboardInterrupt:
            return


@contextlib.contextmanager
def _uncollected() -> Iterator[None]:
    """No search for garbage: what is loaded stays, and searching it takes 0.2 s."""
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def _viewer(
    served: Served,
    files: list[Path],
    tool: ProbeOptions,
    recordings: RecordingOptions,
) -> Viewer:
    """The viewer of fields from files, of the example without any, on open pages."""
    with Stages(2) as begin:
        work = "reading" if files else "fitting the example"
        begin(work)
        note = served.announce(f"{work} …")
        if files:
            fields, options = _read(served, files, tool, recordings)
        else:
            fields, options = shown_example(served)
        begin("drawing")
        from ttus_opt.viewer.viewer import view as opened

        viewer = opened(fields, served=served, **options)
        note.remove()
        return viewer


def _read(
    served: Served,
    files: list[Path],
    tool: ProbeOptions,
    recordings: RecordingOptions,
) -> tuple[list[PotentialField], dict[str, Any]]:
    """Fields, whose skin is drawn at once, and what else is shown, from files."""
    from ttus_opt.viewer.patient_nodes import patients_on
    from ttus_opt.voxmap.field import PotentialField

    fields = [PotentialField.load(file) for file in files]
    patient, mesh = fields[0].voxmap.surface, None
    patients_on(served, patient, len(fields))
    from ttus_opt.probe.mesh import read_mesh  # while browsers draw it
    from ttus_opt.viewer.viewer import probe_of

    if tool.probe is None:
        shell = probe_of(fields[0])
    else:
        shell = probe_for(fields[0].provenance, tool, recordings)
        if ":" not in tool.probe:
            mesh = read_mesh(tool.probe, unit=tool.probe_unit)
    trajectory = None
    if recordings.trajectory:
        if shell is None:
            raise InputError(
                f"{files[0]} does not say which probe it was fitted with: give --probe"
            )
        trajectory = recordings.read(recordings.as_written(), shell, patient)
    names = [file.stem for file in files]
    return fields, {
        "shell": shell,
        "trajectory": trajectory,
        "names": names,
        "mesh": mesh,
    }


def shown_example(served: Served) -> tuple[list[PotentialField], dict[str, Any]]:
    """The bundled example, its skin drawn, fitted, and what else of it is shown."""
    from ttus_opt import example
    from ttus_opt.scan.surface import Surface
    from ttus_opt.viewer.patient_nodes import patients_on

    surface = Surface.load(example.path("surface.nc"))
    patients_on(served, surface, 1)
    from ttus_opt.contact.scene import Scene
    from ttus_opt.fitting.batch import fit
    from ttus_opt.fitting.uncertainty.field_uncertainty import uncertainty
    from ttus_opt.fitting.weights.weight_choice import default_model
    from ttus_opt.probe.point_shell import PointShell
    from ttus_opt.probe.trajectory import Trajectory, read_trajectory
    from ttus_opt.voxmap.voxmap import Voxmap

    shell = PointShell.from_spec(example.PROBE)
    fitted, shown = (
        Trajectory.concatenate(
            [read_trajectory(example.path(f"{name}.csv")) for name in names]
        )
        for names in (EXAMPLE_FITTED, EXAMPLE_SHOWN)
    )
    voxmap = Voxmap.from_surface(surface, shape=EXAMPLE_SHAPE, r_inner=0.03)
    model = default_model(Scene.assemble(voxmap, shell, fitted))
    solution = fit(model.scene, model.formulation)
    found = solution.field
    named = replace(found, provenance={**found.provenance, "probe": example.PROBE})
    return [named], {
        "shell": shell,
        "trajectory": shown,
        "names": ["example"],
        "uncertainty": lambda: uncertainty(solution, model.scene),
    }


def open_browser(url: str) -> None:
    """Open a link where there are windows, not in a terminal's browser."""
    windows = sys.platform in ("win32", "darwin") or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    )
    if windows:
        webbrowser.open(url)
