"""The solver through algebraic multigrid, whose answers the agreement tests judge."""

import pytest

from tests.kit import small_scene
from ttus_opt.problem.formulation import load
from ttus_opt.solvers.base import Claim, Request
from ttus_opt.solvers.packages.amg_pcg import AmgPcg, _Loaded

pytest.importorskip("pyamg", reason="needs ttus-opt[reference]")

SCENE = small_scene("trilinear", shape=(5, 8, 6), n_poses=4)


def test_an_answer_is_claimed_and_out_of_time_there_is_none():
    program = load("eq10", SCENE).compile()
    prepared = AmgPcg().prepare(program, Request(1e-10))
    assert isinstance(prepared, _Loaded)
    assert prepared.solve().claim is Claim.DONE
    found = prepared._attempt(1e-10, 0.0)
    assert found.claim is Claim.TIME_LIMIT and found.x is None
