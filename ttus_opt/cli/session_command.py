"""``ttus-opt session``: from a recording folder to a report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ttus_opt.cli.console import Stages, fitted, tell


def session(
    folder: Annotated[Path, typer.Argument()],
    output: Path,
    trust: bool = False,
) -> None:
    """Process a recording folder into surface, trajectories, field and report.

    Every step writes its files as soon as it is complete; session.json lists them.

    Args:
        folder: Folder with a session.yaml that describes it, or that file.
        output: Folder for the results.
        trust: Execute the Python files that session.yaml names, a formulation or a
            solver; without it they are refused.

    Example:
        ttus-opt session recording -o results
    """
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
    said = fitted(*summary(result)[2:])
    where = f"\nreport.md, report.html, session.json and all steps in {output}/"
    tell(facts, said, where)
