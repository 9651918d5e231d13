"""The choice of ``solver="auto"`` against what every solver took, over the shelf."""

import importlib.util
import sys
from pathlib import Path

import pytest

from ttus_opt.problem.formulation import available

#: Most CPU seconds of a solver that is not yet known to be worse [s]
LIMIT = 30.0


def script():
    """``benchmarks/solver_cost.py``, which is no part of the package."""
    file = Path(__file__).parents[2] / "benchmarks" / "solver_cost.py"
    spec = importlib.util.spec_from_file_location("solver_cost", file)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look for it
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def scenes():
    made = script()
    return made.scene_of((12, 36, 15), 60), made.scene_of(*made.SMALL)


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("formulation", [f.name for f in available()])
def test_the_choice_is_no_worse_than_twice_the_best(formulation, scenes):
    told = script().choice(scenes, formulation, LIMIT)
    assert told.ratio <= 2.0, (told.measured, told.estimated)
