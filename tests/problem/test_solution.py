from __future__ import annotations

import numpy as np
import pytest

from tests.conftest import small_scene
from ttus_opt.fitting.batch import judged
from ttus_opt.problem.formulation import load
from ttus_opt.problem.reduction import reduce
from ttus_opt.problem.solution import NoSolutionError, Status, Timings
from ttus_opt.solvers.base import Candidate, Request

SCENE = small_scene(shape=(5, 8, 5), n_poses=4)


def test_every_status_is_advice() -> None:
    for status in Status:
        assert len(status.value.split()) > 5


def test_times_that_were_not_taken_are_left_out() -> None:
    first = Timings(1.0, 2.0, 3.0)
    assert first.as_dict() == {"assembly": 1.0, "setup": 2.0, "solve": 3.0}
    assert Timings(1.0, 2.0, 3.0, again=0.5).as_dict()["again"] == 0.5
    assert Timings(1.0, 2.0, 3.0, search=9.0).as_dict()["search"] == 9.0


def test_no_solution_carries_program_and_candidate() -> None:
    declared = load("eq10_sign", SCENE)
    reduction = reduce(declared.compile())
    candidate = Candidate(np.ones(SCENE.n_voxels))
    solution = judged(
        declared, reduction, "by hand", candidate, Request(), Timings(0.0, 0.0, 0.0)
    )
    assert solution.status is Status.INACCURATE
    with pytest.raises(NoSolutionError) as caught:
        _ = solution.field
    message = str(caught.value)
    assert "\n" not in message
    assert "eq10_sign: inaccurate, KKT" in message
    assert caught.value.solution.program.variables["p"].stop == SCENE.n_voxels
    assert caught.value.solution.candidate is not None
    assert set(solution.variables) == {"p"}
