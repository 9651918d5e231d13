"""Every part on a small case, in little time."""

from dataclasses import replace
from typing import Any

import pytest

from tests.benchmark.tiny import TINY as TINIER
from ttus_opt.benchmark.machine import Progress
from ttus_opt.benchmark.parts.base import parts
from ttus_opt.benchmark.row import MEASURED, Settings

TINY = replace(TINIER, n_poses=24, n_points=1500)


SETTINGS = Settings(solvers=["structured"], closed_form="", time_limit=60.0)


#: Options with which a part is quick
QUICK: dict[str, dict[str, Any]] = {
    "assembly": {"repeats": 1},
    "recursion": {"updates": 30, "compared": 20},
    "rendering": {"passes": 2},
    "ripple": {"voxel": 0.004, "n_points": 600, "n_poses": 20},
}


every_part = pytest.mark.parametrize("part", parts().values(), ids=lambda p: p.name)


def measured(part, folder):
    spec = part.plan([TINY], SETTINGS)[0]
    spec = replace(spec, options={**spec.options, **QUICK.get(part.name, {})})
    rows = part.measure(spec, Progress(folder))
    return [part.row(spec, MEASURED, "") | row for row in rows]
