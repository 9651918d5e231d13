"""``ttus-opt solvers`` and ``ttus-opt formulations``: what there is to choose from."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ttus_opt.cli.console import tell

if TYPE_CHECKING:
    from ttus_opt.solvers.base import Solver


def solvers(json: bool = False) -> None:
    """List the solvers, installed or not, and the problems each can solve.

    Example:
        ttus-opt solvers --json
    """
    from ttus_opt.report.document import Table
    from ttus_opt.solvers import registry

    known, order = registry.solvers(), registry.estimating()
    facts = {"solvers": [_solver(s) for s in known.values()], "auto_tries": order}
    header = ["solver", "installed", "solves", "a re-solve keeps", "about"]
    body = [
        [
            name,
            "yes" if solver.installed else f"no: pip install {solver.pip_name}",
            ", ".join(_takes(solver)),
            solver.capabilities.keeps or "nothing",
            solver.summary,
        ]
        for name, solver in known.items()
    ]
    auto = (
        "\nauto picks the installed solver with the lowest time estimate for the "
        f"problem, from {', '.join(order)}"
    )
    tell(facts, str(Table(header, body)), auto, json=json)


def formulations(json: bool = False) -> None:
    """List the formulations that come with the package, and their options.

    Example:
        ttus-opt formulations --json
    """
    from ttus_opt.problem import formulation
    from ttus_opt.report.document import Table

    known = formulation.available()
    rows = [{"name": f.name, "summary": f.summary, "options": f.options} for f in known]
    body = [[f.name, f.summary, ", ".join(map(str, f.options)) or "–"] for f in known]
    listed = str(Table(["formulation", "about", "options"], body))
    own = "\nName your own file, with a function build(scene, **options), by its path."
    tell({"formulations": rows}, listed, own, json=json)


def _takes(solver: Solver) -> list[str]:
    can = solver.capabilities
    takes = {
        "any terms": can.any_terms,
        "equalities": can.equalities,
        "inequalities": can.inequalities,
        "penalties other than squares": can.nonquadratic,
        "time limit": can.time_limit,
    }
    listed = [what for what, able in takes.items() if able]
    return listed if can.any_terms else ["Laplace and measured rows", *listed]


def _solver(solver: Solver) -> dict[str, object]:
    can = solver.capabilities
    return {
        "name": solver.name,
        "installed": solver.installed,
        "install": solver.pip_name,
        "summary": solver.summary,
        "any_terms": can.any_terms,
        "equalities": can.equalities,
        "inequalities": can.inequalities,
        "nonquadratic": can.nonquadratic,
        "keeps": can.keeps,
        "time_limit": can.time_limit,
    }
