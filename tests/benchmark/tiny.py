"""A tiny case, and a formulation that behaves on its stand-in only."""

import textwrap
from dataclasses import replace

from ttus_opt.benchmark.cases import SMALL_SHAPE, reference_cases
from ttus_opt.benchmark.row import RunSpec, Settings
from ttus_opt.benchmark.suite import Suite

TINY = replace(
    reference_cases("S")[0], name="tiny", shape=(9, 20, 9), n_poses=10, n_points=300
)

#: A case whose small stand-in is smaller, whatever that is
TRAPPED = replace(
    TINY, name="trapped", shape=tuple(n + 1 for n in SMALL_SHAPE), n_poses=10
)

#: A formulation that behaves on the small stand-in and does something else on the case
TRAP = """
from formulations import eq10

def build(scene):
    if scene.n_voxels == {size}:
        {deed}
    return eq10.build(scene)
"""


def trapped(folder, deed, solver="osqp"):
    """A run that does something in the midst of it."""
    assert TRAPPED.small().n_voxels != TRAPPED.n_voxels
    file = folder / "trap.py"
    indented = textwrap.indent(deed, " " * 8).strip()
    file.write_text(TRAP.format(size=TRAPPED.n_voxels, deed=indented))
    asked = {"formulation": str(file), "options": {}, "solver": solver}
    return RunSpec("solvers", TRAPPED, {**asked, "tolerance": 1e-6, "repeat": 1}, 30.0)


def tiny_suite(folder, cases=(TINY,), *, jobs=1, parts=("solvers",), **settings):
    """Two solvers on eq. 10, unless asked for otherwise."""
    asked = {"solvers": ["closed_form", "osqp"], "time_limit": 60.0, **settings}
    return Suite(cases, folder, Settings(**asked), parts, jobs)
