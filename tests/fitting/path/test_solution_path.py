"""A path of weights: every point is the fit of its weights, in an annotated dataset."""

import warnings

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError, TtusWarning, presses, small_scene, torso
from ttus_opt.fitting.path import path_solvers
from ttus_opt.fitting.path.solution_path import several_at_a_time

WEIGHTS = np.geomspace(1e-4, 1e2, 4)


def unseen():
    return presses(torso(), 6, np.random.default_rng(9))


@pytest.fixture(scope="module")
def path():
    return tt.solution_path(
        "eq10",
        small_scene("trilinear"),
        weights={("force", "torque"): WEIGHTS},
        extras=["potential"],
    )


def test_every_point_is_a_fit(path):
    scene = small_scene("trilinear")
    for k, weight in enumerate(WEIGHTS):
        alone = tt.fit(scene, "eq10", force_weight=weight, torque_weight=weight)
        at = path.isel(force_weight=k)
        assert at["status"] == 0 and at["kkt_residual"] < 1e-6
        assert float(at["objective"]) == pytest.approx(alone.objective, rel=1e-8)
        size = np.abs(alone.field.values).max()
        off = np.abs(at["potential"].to_numpy() - alone.field.values).max()
        assert off < 1e-6 * size
    assert path.attrs["solver"] == "structured"
    assert path.attrs["points_done"] == path.attrs["points"] == len(WEIGHTS)


def test_a_drag_coefficient_is_a_variable():
    scene = small_scene("trilinear")
    path = tt.solution_path("viscous_drag", scene, weights={"force": [1e-2, 1.0]})
    found = path["parameter_viscous_coefficient"]
    assert found.attrs["units"] == "N s m-1"
    declared = tt.load_formulation("viscous_drag", scene, force_weight=1.0)
    alone = tt.Fitter(declared).solve()
    value = alone.parameters["viscous_coefficient"]
    assert float(found[1]) == pytest.approx(value, rel=1e-4, abs=1e-6)


class Stumbling(path_solvers.PointSolver):
    """Solves until a point, where it does something else."""

    def __init__(self, solve, at, what):
        self._solve, self._left, self._what = solve, at, what

    def __call__(self, declared):
        self._left -= 1
        return self._what(declared) if self._left < 0 else self._solve(declared)


def stumbling(monkeypatch, what):
    plain = path_solvers.point_solver

    def instead(*given):
        return Stumbling(plain(*given), 2, what)

    monkeypatch.setattr("ttus_opt.fitting.path.solution_path.point_solver", instead)


def test_an_interrupt_keeps_what_is_done(monkeypatch):
    def interrupt(declared):
        raise KeyboardInterrupt

    stumbling(monkeypatch, interrupt)
    scene = small_scene("trilinear")
    with pytest.warns(TtusWarning, match="2 of 4 points"):
        path = tt.solution_path("eq10", scene, weights={"force": WEIGHTS})
    assert path["status"].to_numpy().tolist() == [0, 0, -1, -1]
    assert np.isfinite(path["objective"].to_numpy()).tolist() == [1, 1, 0, 0]
    assert path.attrs["points_done"] == 2
    assert "missing" in path["status"].attrs["flag_meanings"].split()[0]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"weights": {"forse": [1.0]}}, "no term 'forse'"),
        (
            {"weights": {"force": [1.0]}, "held_out": "press.csv"},
            "must be a Trajectory",
        ),
        ({"weights": {"force": [1.0]}, "solver": "none"}, "unknown solver"),
        ({"weights": {"force": [1.0]}, "tolerance": 2.0}, "tolerance"),
    ],
)
def test_bad_input_is_one_line(given, words):
    with pytest.raises(InputError, match=words):
        tt.solution_path("eq10", small_scene("trilinear"), **given)


def test_a_name_needs_a_scene_and_a_recording_a_wrench():
    with pytest.raises(InputError, match="needs a scene"):
        tt.solution_path("eq10", weights={"force": [1.0]})
    one = unseen()
    bare = tt.Trajectory(one.time, one.position, one.rotation)
    with pytest.raises(InputError, match="no wrench"):
        tt.solution_path(
            "eq10", small_scene("trilinear"), weights={"force": [1.0]}, held_out=bare
        )


@pytest.mark.slow
def test_a_searched_coefficient_is_found_at_every_point():
    scene = small_scene("trilinear")
    path = tt.solution_path("coulomb_global", scene, weights={"force": [1e-2, 1.0]})
    alone = tt.fit(scene, "coulomb_global", force_weight=1.0)
    found = float(path["parameter_friction_coefficient"][1])
    assert found == pytest.approx(alone.parameters["friction_coefficient"], abs=1e-6)


def warned(declared):
    warnings.warn("of one place", TtusWarning, stacklevel=1)
    warnings.warn(f"only of {declared}", TtusWarning, stacklevel=1)
    return f"fit of {declared}"


@pytest.mark.slow
def test_a_warning_of_several_points_is_told_once():
    points = [(0,), (1,), (2,)]
    found = several_at_a_time(warned, points, lambda i: i[0] % 2, 2, "")
    with pytest.warns(TtusWarning) as told:
        by_point = {index: fit for index, fit, _ in found}
    assert by_point == {(i,): f"fit of {i % 2}" for i in range(3)}
    messages = sorted(str(one.message) for one in told)
    assert messages == ["of one place", "only of 0", "only of 1"]
