"""``ttus-opt benchmark``: every solver on every formulation, compared honestly."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from ttus_opt.cli.console import print_json
from ttus_opt.cli.options import Json, whole_numbers
from ttus_opt.errors import InputError

if TYPE_CHECKING:
    from ttus_opt.benchmark import CaseSpec, Row, Suite
    from ttus_opt.benchmark.parts.base import Figures, PartSpec
    from ttus_opt.benchmark.parts.suite import PartSuite

EXAMPLE = (
    "ttus-opt benchmark --case S --formulations eq10,eq10_sign "
    "--solvers structured,closed_form,clarabel,osqp --time-limit 300 -o results"
)

#: Name of a case that is a user's own
OWN = "user"


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("benchmark", epilog=f"Example: {EXAMPLE}")(benchmark)


def benchmark(
    case: Annotated[
        str, typer.Option(help="S, M, L or all; not with a scene of your own.")
    ] = "S",
    formulations: Annotated[
        str, typer.Option(help="Names or paths, separated by commas.")
    ] = "eq10",
    solvers: Annotated[
        str,
        typer.Option(
            help="Names separated by commas, or all that are installed, closed forms "
            "up to 100,000 voxels only."
        ),
    ] = "all",
    closed_form: Annotated[
        str,
        typer.Option(
            help="Reference of the first table: closed_form, closed_form_pardiso, …, "
            "none, or auto: closed_form on cases of up to 100,000 voxels (S), none on "
            "larger ones, where it would pass the time limit."
        ),
    ] = "auto",
    repeat: Annotated[int, typer.Option(help="Times each is measured.")] = 1,
    time_limit: Annotated[
        float, typer.Option(help="Most seconds of one solve, set-up included.")
    ] = 600.0,
    tolerance: Annotated[
        float, typer.Option(help="Largest relative residual of a solution.")
    ] = 1e-6,
    output: Annotated[
        Path,
        typer.Option("-o", "--output", help="Folder; a second call goes on there."),
    ] = Path("benchmark-results"),
    surface: Annotated[
        str | None, typer.Option(help="Surface file of your own scene.")
    ] = None,
    probe: Annotated[str | None, typer.Option(help="Its probe.")] = None,
    trajectory: Annotated[
        list[str] | None,
        typer.Option(metavar="PATH", help="Its recordings; may be repeated."),
    ] = None,
    shape: Annotated[str, typer.Option(help="Its voxels in r, θ, z.")] = "48,120,60",
    r_inner: Annotated[float, typer.Option(help="Its innermost radius [m].")] = 0.03,
    inner: Annotated[
        str, typer.Option(help="Its value on the inner layer, or fit.")
    ] = "fit",
    sampling: Annotated[
        str, typer.Option(help="Sampling of any scene: voxel-mean or trilinear.")
    ] = "trilinear",
    contest: Annotated[
        str,
        typer.Option(
            help="Contest the measured wrenches, so that limits become active: noise "
            "(with --weight 1 and more) or reversed (a fifth; with --weight 100)."
        ),
    ] = "",
    weight: Annotated[
        float,
        typer.Option(help="Weight of force and torque rows; not of --parts' own fits."),
    ] = 1e-2,
    jobs: Annotated[
        int, typer.Option(help="Runs at a time; times compare with one only.")
    ] = 1,
    dask: Annotated[
        str, typer.Option(help="Address of a dask scheduler, host:port.")
    ] = "",
    memory_limit: Annotated[
        float | None,
        typer.Option(help="Most GiB of one run; by default 80 % of what is free."),
    ] = None,
    memory: Annotated[
        bool,
        typer.Option(
            "--memory",
            help="Show the peak memory of each stage; that of the whole process is in "
            "every row anyway.",
        ),
    ] = False,
    export: Annotated[
        Path | None,
        typer.Option(help="Write the problems as .mat and .npz here, run nothing."),
    ] = None,
    parts: Annotated[
        str,
        typer.Option(
            help="What is measured: solvers, assembly, profile, recursion, rendering, "
            "ripple, separated by commas, or all. All but solvers run one at a time."
        ),
    ] = "solvers",
    json: Json = False,
) -> None:
    """Compare solvers by time, memory and verified residual, one process a run."""
    from ttus_opt.benchmark import Suite
    from ttus_opt.benchmark.machine import describe
    from ttus_opt.benchmark.parts.registry import SOLVERS, chosen
    from ttus_opt.benchmark.parts.suite import PartSuite

    names = chosen(parts)
    cases = [
        each.contested(contest)
        for each in _cases(
            case, surface, probe, trajectory or (), shape, r_inner, inner, sampling
        )
    ]
    suite = Suite(
        cases,
        _listed(formulations),
        () if solvers == "all" else _listed(solvers),
        output,
        "" if closed_form == "none" else closed_form,
        tolerance=tolerance,
        time_limit=time_limit,
        repeat=repeat,
        jobs=jobs,
        dask=dask,
        memory_limit=None if memory_limit is None else int(memory_limit * 2**30),
        weight=weight,
    )
    if export is not None:
        _export(suite, export, json)
        return
    machine = describe()  # its load is that at the start
    suite.plan()  # tells what is wrong before anything runs
    rows = _run(suite) if SOLVERS in names else []
    others = PartSuite(names, cases, output, time_limit, suite.allowance)
    found = _run_parts(others)
    report = _report(suite, rows, found, machine, memory)
    if json:
        solved = {"rows": [row.as_dict() for row in rows]}
        print_json({**solved, **found, "report": str(report)})
    else:
        if rows:
            _tell(suite, rows, memory)
        _tell_parts(found)
        typer.echo(f"\n{report}")


def _listed(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def _cases(
    case: str,
    surface: str | None,
    probe: str | None,
    trajectory: Sequence[str],
    shape: str,
    r_inner: float,
    inner: str,
    sampling: str,
) -> list[CaseSpec]:
    from ttus_opt.benchmark import CaseSpec, reference_cases
    from ttus_opt.benchmark.cases import existing

    if surface is None and probe is None and not trajectory:
        return [each.sampled(sampling) for each in reference_cases(case)]
    if surface is None or probe is None or not trajectory:
        raise InputError(
            "a scene of your own needs --surface, --probe and --trajectory together"
        )
    n_r, n_theta, n_z = whole_numbers(shape, 3, "--shape")
    own = CaseSpec(
        OWN,
        surface,
        probe,
        tuple(trajectory),
        (n_r, n_theta, n_z),
        r_inner=r_inner,
        inner=_inner(inner),
        sampling=sampling,
    )
    return [existing(own)]


def _inner(text: str) -> float | Literal["fit"]:
    if text == "fit":
        return "fit"
    try:
        return float(text)
    except ValueError:
        raise InputError(f"--inner takes a number or fit, got {text!r}") from None


def _run(suite: Suite) -> list[Row]:
    """Run with a bar on stderr."""
    from tqdm import tqdm

    with tqdm(
        total=len(suite.plan()), file=sys.stderr, unit="run", dynamic_ncols=True
    ) as bar:

        def told(row: Row) -> None:
            bar.set_postfix_str(
                f"{row.case} {row.formulation} {row.solver}: {row.status}"
            )
            bar.update()

        return suite.run(told)


def _run_parts(suite: PartSuite) -> dict[str, list[Figures]]:
    """The same for the parts beside the solvers."""
    from tqdm import tqdm

    plan = suite.plan()
    if not plan:
        return suite.run()
    with tqdm(total=len(plan), file=sys.stderr, unit="run", dynamic_ncols=True) as bar:

        def told(spec: PartSpec, rows: list[Figures]) -> None:
            bar.set_postfix_str(f"{spec.case_name} {spec.part}: {rows[0]['status']}")
            bar.update()

        return suite.run(told)


def _report(
    suite: Suite,
    rows: Sequence[Row],
    found: Mapping[str, Sequence[Figures]],
    machine: Mapping[str, str],
    memory: bool,
) -> Path:
    from ttus_opt.benchmark.page import write_page

    return write_page(
        suite.output,
        rows,
        closed_form=suite.reference,
        command=shlex.join(["ttus-opt", *sys.argv[1:]]),
        machine=machine,
        memory=memory,
        parts=found,
    )


def _tell(suite: Suite, rows: Sequence[Row], memory: bool) -> None:
    from ttus_opt.benchmark.summary import (
        closed_form_table,
        memory_table,
        row_table,
        score_table,
    )

    against = closed_form_table(rows, suite.reference)
    if against:
        typer.echo(f"Against the closed form:\n{against}\n")
    for name, formulation in dict.fromkeys((r.case, r.formulation) for r in rows):
        own = [r for r in rows if (r.case, r.formulation) == (name, formulation)]
        typer.echo(
            f"{name}, {formulation}, {own[0].voxels:,} voxels:\n{row_table(own)}\n"
        )
    typer.echo(f"Shifted geometric means:\n{score_table(rows)}")
    if memory:
        typer.echo(f"\nMemory by stage [MiB]:\n{memory_table(rows)}")


def _tell_parts(found: Mapping[str, Sequence[Figures]]) -> None:
    from ttus_opt.benchmark.parts.registry import parts

    for name, rows in found.items():
        if rows:
            part = parts()[name]
            typer.echo(f"\n{part.title}:\n{part.table(rows)}")


def _export(suite: Suite, folder: Path, json: bool) -> None:
    from ttus_opt.benchmark.export import export_program
    from ttus_opt.problem import formulation as shelf

    written = []
    for spec in {(s.case.name, s.formulation): s for s in suite.plan()}.values():
        declared = shelf.load(spec.formulation, spec.case.build(), **spec.options)
        files = export_program(
            declared.compile(), folder, f"{spec.case.name}_{spec.label}"
        )
        written += [str(files.matlab), str(files.numpy)]
    if json:
        print_json({"files": written})
    else:
        typer.echo("\n".join(written))
