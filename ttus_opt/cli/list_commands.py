"""``ttus-opt solvers`` and ``ttus-opt formulations``: what there is to choose from."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from ttus_opt.cli.console import fitted, tell, wrapped

if TYPE_CHECKING:
    from ttus_opt.solvers.base import Solver


#: What a solver can take: a letter, the capability of that name, and its meaning
TAKES = (
    ("A", "any_terms", "any terms (else Laplace and measured rows)"),
    ("E", "equalities", "equalities"),
    ("I", "inequalities", "inequalities"),
    ("P", "nonquadratic", "penalties other than squares"),
    ("T", "time_limit", "a time limit"),
    ("K", "keeps", "keeps work for the next solve"),
)


def solvers() -> None:
    """List the solvers, installed or not, and the problems each can solve.

    Example:
        ttus-opt solvers --json
    """
    from ttus_opt.report.document import Table
    from ttus_opt.solvers import registry

    known = registry.solvers()
    order = [name for name in registry.estimating() if known[name].installed]
    told = [
        {
            "name": s.name,
            "installed": s.installed,
            "install": s.pip_name,
            "summary": s.summary,
            **asdict(s.capabilities),
        }
        for s in known.values()
    ]
    body = [
        [name, _letters(solver), solver.summary]
        for name, solver in known.items()
        if solver.installed
    ]
    absent = [
        f"{name} ({solver.pip_name})"
        for name, solver in known.items()
        if not solver.installed
    ]
    meanings = ", ".join(f"{letter} {what}" for letter, _, what in TAKES)
    paragraphs = [
        meanings,
        f"Not installed, with the package to install: {', '.join(absent) or 'none'}",
        "auto picks the installed solver with the lowest time estimate for the "
        f"problem, from {', '.join(order)}",
    ]
    listed = fitted(Table(["solver", "takes", "about"], body))
    facts = {"solvers": told, "auto_tries": order}
    tell(facts, listed, *(f"\n{wrapped(p)}" for p in paragraphs))


def formulations() -> None:
    """List the formulations that come with the package, and their options.

    Example:
        ttus-opt formulations --json
    """
    from ttus_opt.problem import formulation
    from ttus_opt.report.document import Table

    known = formulation.available()
    rows = [{"name": f.name, "summary": f.summary, "options": f.options} for f in known]
    first, *others = [f.options for f in known if f.options]
    usual = [o for o in first if all(o in options for options in others)]
    body = []
    for found in known:
        further = ", ".join(str(o) for o in found.options if o not in usual)
        body.append([found.name, found.summary + f" [{further}]" * bool(further)])
    listed = fitted(Table(["formulation", "about [further options]"], body))
    own = wrapped(
        f"All with measurements take {', '.join(map(str, usual))}. Name your own file, "
        "with a function build(scene, **options), by its path."
    )
    tell({"formulations": rows}, listed, f"\n{own}")


def _letters(solver: Solver) -> str:
    """What of `TAKES` a solver takes; a dot for what it does not."""
    can = solver.capabilities
    return "".join(letter if getattr(can, name) else "·" for letter, name, _ in TAKES)
