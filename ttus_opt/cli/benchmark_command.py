"""``ttus-opt benchmark``: every solver on every formulation, residuals verified."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ttus_opt.cli.console import bars_shown, fitted, tell
from ttus_opt.cli.options import listed, voxel_counts
from ttus_opt.cli.scene_options import boundary_value
from ttus_opt.core.errors import InputError

if TYPE_CHECKING:
    from ttus_opt.benchmark import CaseSpec, Row, RunSpec, Suite


#: A run's part of the bar is half full after this time [s]
HALF = 30.0

#: Name of a case that is a user's own
OWN = "user"


@dataclass(frozen=True)
class OwnScene:
    """A scene beside the reference cases, as typed.

    Attributes:
        surface: Surface file of your own scene.
        probe: Probe of your own scene.
        trajectory: Recordings of your own scene; may be repeated.
        shape: Number of voxels in r, θ, z of your own scene.
        r_inner: Innermost radius of your own scene [m].
        inner: Potential on the inner layer of your own scene, or fit.
        sampling: Sampling of any scene: trilinear, voxel-mean or contact-size.
    """

    surface: str | None = None
    probe: str | None = None
    trajectory: Annotated[list[str] | None, typer.Option(metavar="PATH")] = None
    shape: str = "48,120,60"
    r_inner: float = 0.03
    inner: str = "fit"
    sampling: str = "trilinear"

    def cases(self, names: str) -> list[CaseSpec]:
        """The reference cases of these names, or the user's own scene.

        Raises:
            InputError: No such case, a scene half given, or invalid numbers.
            FileError: A file is not there.
        """
        from ttus_opt.benchmark import CaseSpec, reference_cases
        from ttus_opt.benchmark.cases import existing

        if self == OwnScene(sampling=self.sampling):
            return [each.sampled(self.sampling) for each in reference_cases(names)]
        if self.surface is None or self.probe is None or not self.trajectory:
            raise InputError(
                "a scene of your own needs --surface, --probe and --trajectory together"
            )
        own = CaseSpec(
            voxel_counts(self.shape),
            self.r_inner,
            inner=boundary_value(self.inner),
            sampling=self.sampling,
            name=OWN,
            surface=self.surface,
            probe=self.probe,
            trajectories=tuple(self.trajectory),
        )
        return [existing(own)]


def benchmark(
    *,
    case: str = "S",
    formulations: str = "eq10",
    solvers: str = "all",
    closed_form: str = "auto",
    repeat: int = 1,
    time_limit: float = 600.0,
    tolerance: float = 1e-6,
    output: Path = Path("benchmark-results"),
    own: OwnScene,
    boundary: str = "subvoxel",
    perturb: str = "",
    weight: float = 1e-2,
    jobs: int = 1,
    dask: str = "",
    memory_limit: float | None = None,
    memory: bool = False,
    export: Path | None = None,
    parts: str = "solvers",
) -> None:
    """Compare solvers by time, memory and verified residual, one process per run.

    Args:
        case: S, M, L, XL, several separated by commas, or all (without XL). Leave it
            out with a scene of your own.
        formulations: Names or paths separated by commas, or all.
        solvers: Names or paths of your own files, separated by commas; auto: the solver
            that a fit takes; all: those installed, closed forms only up to 100,000
            voxels.
        closed_form: Reference of the first table: closed_form, closed_form_pardiso, …,
            none, or auto: closed_form on cases of up to 100,000 voxels (S), none on
            larger ones, where it would exceed the time limit.
        repeat: Number of measurements of each run.
        time_limit: Time limit of one solve, set-up included [s]; a run may take twice
            as long to report how far it came.
        tolerance: Largest relative KKT residual of a solution.
        output: Folder of the results; a second call continues there.
        boundary: Where p = 0 lies in any scene: subvoxel or staircase.
        perturb: Perturb the measured wrenches so that limits become active: noise (use
            --weight 1 or more) or reversed (a fifth of them; use --weight 100).
        weight: Weight of force and torque rows. Fits of other --parts have their own.
        jobs: Number of runs at a time; only with one are times comparable.
        dask: Address of a dask scheduler, host:port.
        memory_limit: Memory limit of one run [GiB]. By default 80 % of the free memory.
        memory: Show the peak memory of each stage; every row has that of the whole
            process anyway.
        export: Write the problems as .mat and .npz here instead of solving them.
        parts: What to measure: solvers, assembly, profile, recursion, rendering,
            ripple, live, separated by commas, or all. All but solvers run one at a
            time.

    Example:
        ttus-opt benchmark --case S --formulations eq10,eq10_sign --solvers
        structured,closed_form,clarabel,osqp --time-limit 300 -o results
    """
    from ttus_opt.benchmark import Settings, Suite
    from ttus_opt.benchmark.machine import describe
    from ttus_opt.benchmark.parts.base import parts as every
    from ttus_opt.core.arguments import chosen, expect_positive

    machine = describe()  # its load is that at the start
    names = chosen(listed(parts) or [parts], every(), "part")
    cases = own.cases(case)
    if memory_limit is not None:
        expect_positive(memory_limit, "--memory-limit", "GiB")
    settings = Settings(
        time_limit,
        listed(formulations),
        listed(solvers),
        "" if closed_form == "none" else closed_form,
        tolerance=tolerance,
        repeat=repeat,
        weight=weight,
        memory=memory,
    )
    suite = Suite(
        [each.bounded(boundary).perturbed(perturb) for each in cases],
        output,
        settings,
        names,
        jobs,
        dask,
        None if memory_limit is None else int(memory_limit * 2**30),
    )
    if export is not None:
        _export(suite, export)
    else:
        _run(suite, machine)


class _Watched:
    """A bar over runs that moves within each, and names what runs."""

    def __init__(self, bar: Any) -> None:
        self._bar, self._done = bar, 0
        self._begun: dict[str, float] = {}
        self._show(0.0, "")

    def told(self, spec: RunSpec, rows: Sequence[Row]) -> None:
        """A run ended."""
        self._begun.pop(spec.key, None)
        self._done += 1
        self._show(0.0, f"{spec.title}: {rows[0]['status']}")

    def watching(self, spec: RunSpec, stage: str, since: float) -> None:
        """A run is under way."""
        spent = time.monotonic() - self._begun.setdefault(spec.key, time.monotonic())
        # nobody knows how long it will take: half of its part in the first half minute
        part = spent / (spent + HALF)
        self._show(part, f"{spec.title}: {stage}, {since:.0f} s")

    def _show(self, part: float, words: str) -> None:
        self._bar.n = min(self._done + part, self._bar.total)
        self._bar.set_description_str(
            f"{self._done} of {self._bar.total} runs", refresh=False
        )
        self._bar.set_postfix_str(words)


def _run(suite: Suite, machine: dict[str, str]) -> None:
    """Run with a bar on stderr, write the report, tell the figures."""
    from tqdm import tqdm

    from ttus_opt.benchmark.parts.base import parts
    from ttus_opt.benchmark.report import write_report
    from ttus_opt.benchmark.row import MEASURED

    total = len(suite.plan)  # tells what is wrong before anything runs
    shape = "{desc} |{bar:20}| {elapsed}{postfix}"
    quiet = not bars_shown()
    with tqdm(total=total, file=sys.stderr, bar_format=shape, disable=quiet) as bar:
        watched = _Watched(bar)
        try:
            # a file or a pipe gets finished runs only
            found = suite.run(
                watched.told, watched.watching if sys.stderr.isatty() else None
            )
        except KeyboardInterrupt:
            bar.close()
            done = f"finished runs are in {suite.rows_file}"
            typer.echo(f"{done}: repeat the call to continue", err=True)
            raise
    report = write_report(
        suite.output,
        found,
        suite.settings,
        command=shlex.join(["ttus-opt", *sys.argv[1:]]),
        machine=machine,
    )
    rows = {parts()[name].key or name: told for name, told in found.items()}
    texts = [
        f"{fitted(*parts()[name].text(own, suite.settings))}\n"
        for name, own in found.items()
        if own
    ]
    tell({**rows, "report": str(report)}, *texts, str(report))
    if not any(
        r["status"] in ("solved", MEASURED) for own in found.values() for r in own
    ):
        typer.echo(f"error: no run succeeded: {report} says why", err=True)
        raise typer.Exit(1)


def _export(suite: Suite, folder: Path) -> None:
    """Write the solvers' problems, each once."""
    from ttus_opt.benchmark.export import export_program
    from ttus_opt.benchmark.parts.base import SOLVERS
    from ttus_opt.benchmark.solver_run import declared

    runs = {
        f"{spec.case_name}_{Path(spec.options['formulation']).stem}": spec
        for spec in suite.plan
        if spec.part == SOLVERS
    }
    if not runs:
        raise InputError("--export writes the solvers' problems: leave --parts out")
    written: list[str] = []
    for name, spec in runs.items():
        program = declared(spec, spec.scene_case.scene()).compile()
        written += map(str, export_program(program, folder, name))
    tell({"files": written}, *written)
