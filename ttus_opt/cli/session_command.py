"""``ttus-opt session``: from a recording folder to a report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ttus_opt.cli.console import Stages, tell
from ttus_opt.core.errors import InputError


def session(
    folder: Annotated[Path, typer.Argument()],
    output: Path | None = None,
    example: bool = False,
    trust: bool = False,
    json: bool = False,
) -> None:
    """Process a recording folder into surface, trajectories, field and report.

    Every step writes its files as soon as it is complete; session.json lists them.

    Args:
        folder: Folder with a session.yaml that describes it, or that file.
        output: Folder for the results.
        example: Write a synthetic recording into FOLDER instead.
        trust: Execute the Python files that session.yaml names, a formulation or a
            solver; without it they are refused.

    Example:
        ttus-opt session recording -o results
    """
    if example:
        _write_example(folder, output, json)
        return
    if output is None:
        raise InputError("--output is missing: give a folder for the results")
    from ttus_opt.report.document import text
    from ttus_opt.session import run_session
    from ttus_opt.session.report import summary
    from ttus_opt.session.results import STEPS, complete_steps

    begun: list[str] = []
    try:
        with Stages(len(STEPS)) as begin:

            def reported(step: str) -> None:
                begun.append(step)
                begin(step)

            result = run_session(folder, output, progress=reported, trust=trust)
    except KeyboardInterrupt:
        done = [step for step in complete_steps(output) if step in begun[:-1]]
        steps = ", ".join(done) or "nothing"
        typer.echo(f"complete in {output}: {steps}", err=True)
        raise
    facts = {"output": str(output), **result.figures, "report": f"{output}/report.md"}
    said = text(summary(result)[2:])
    where = f"\nreport.md, report.html, session.json and all steps in {output}/"
    tell(facts, said, where, json=json)


def _write_example(folder: Path, output: Path | None, json: bool) -> None:
    from ttus_opt.session.synthetic import write_recording

    if output is not None:
        raise InputError("--example writes into FOLDER: leave --output out")
    with Stages(1) as begin:
        begin("making the recording")
        truth = write_recording(folder)
    line = f"{folder}: a synthetic recording; ttus-opt session {folder} -o results"
    tell({"folder": str(folder), "truth": truth.as_dict()}, line, json=json)
