"""What a path notes of its points: against fits noted by hand, to a file and back."""

from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import FileError, presses, refuses, small_scene, torso
from ttus_opt.fitting.path import path_dataset
from ttus_opt.fitting.path.weight_grid import WeightGrid
from ttus_opt.problem.formulation import load
from ttus_opt.problem.solution import Status, Timings

FORCE, TORQUE = [0.1, 10.0], [0.5, 5.0]
TWO = np.arange(12) >= 7  # frames of the second recording


def scene():
    """Two recordings, numbers 3 and 8."""
    whole = small_scene("trilinear", shape=(6, 9, 6))
    segments = np.where(TWO, 8, 3)
    return replace(whole, trajectory=replace(whole.trajectory, segment=segments))


def unseen(seed):
    return presses(torso(), 5, np.random.default_rng(seed))


def formulation():
    return load("eq10", scene())


def solved(index):
    weights = {"force": FORCE[index[0]], "torque": TORQUE[index[1]]}
    return tt.Fitter(formulation().with_weights(**weights)).solve()


@pytest.fixture(scope="module")
def noted():
    """Four points: solved, solved again, refused by its check, not reached."""
    declared = formulation()
    grid = WeightGrid.of({"force": FORCE, "torque": TORQUE}, ["force", "torque"])
    held_out = {"one": unseen(1), "two": unseen(2)}
    record = path_dataset.PathRecord(declared, grid, held_out, 1e-6, keep_fields=True)
    points = {
        (0, 0): replace(solved((0, 0)), timings=Timings(9.0, 1.0, 2.0)),
        (0, 1): replace(
            solved((0, 1)),
            timings=Timings(9.0, 1.0, 2.0, again=0.5, search=0.25),
            solver="another",
            parameters={"viscous_coefficient": 4.0},
        ),
        (1, 0): replace(solved((1, 0)), status=Status.INACCURATE, verified_field=None),
    }
    for index, solution in points.items():
        criteria = {"gcv": 10.0 + index[1]} if index == (0, 1) else None
        record.add(index, solution, criteria)
    return record.dataset(), points


def test_every_point_has_its_status(noted):
    found, points = noted
    flags = found["status"].attrs
    names = dict(zip(flags["flag_values"], flags["flag_meanings"].split(), strict=True))
    told = [[names[int(v)] for v in row] for row in found["status"].to_numpy()]
    assert told == [["solved", "solved"], ["inaccurate", "missing"]]
    assert found.attrs["points"] == 4 and found.attrs["points_done"] == 3
    assert found.attrs["solver"] == f"{points[0, 0].solver}, another"


def test_times_are_those_of_the_point_alone(noted):
    seconds = noted[0]["seconds"].to_numpy()
    np.testing.assert_array_equal(seconds[0], [3.0, 0.75])
    assert np.isnan(seconds[1, 1])


def test_a_point_that_failed_its_check_has_its_residual_alone(noted):
    found, points = noted
    at = found.isel(force_weight=1, torque_weight=0)
    assert float(at["kkt_residual"]) == points[1, 0].kkt.worst_relative
    for name in found.data_vars:
        if name not in ("status", "kkt_residual", "seconds"):
            assert at[name].isnull().all(), name


def test_terms_and_residuals_are_those_of_the_fields(noted):
    """By the matrices, without their weights, recording by recording."""
    found, points = noted
    declared, own = formulation(), scene()
    for index in ((0, 0), (0, 1)):
        at = found.isel(force_weight=index[0], torque_weight=index[1])
        p = points[index].candidate
        for term in declared.compile().terms:
            r = term.matrix @ p - term.target
            value = float(at["term_value"].sel(term=term.name))
            assert value == pytest.approx(float(r @ r), rel=1e-8)
        force = ((own.N @ p - own.f) ** 2).reshape(-1, 3).sum(axis=1)
        torque = ((own.W @ p - own.tau) ** 2).reshape(-1, 3).sum(axis=1)
        for name, part in (("3", ~TWO), ("8", TWO)):
            here = at.sel(recording=name)
            expected = np.sqrt(force[part].mean())
            assert float(here["force_residual"]) == pytest.approx(expected)
            expected = 1e3 * np.sqrt(torque[part].mean())
            assert float(here["torque_residual"]) == pytest.approx(expected)
        assert float(at["objective"]) == points[index].objective
        field = points[index].field
        np.testing.assert_array_equal(at["potential"], field.values)
        for name, recording in (("one", unseen(1)), ("two", unseen(2))):
            errors = tt.evaluate(field, own.shell, recording).errors
            told = at.sel(held_out=name)["held_out_torque_magnitude_error"]
            expected = 1e3 * errors.torque_magnitude_error_Nm
            assert float(told) == pytest.approx(expected, rel=1e-9)


def test_what_only_some_points_have_is_missing_elsewhere(noted):
    for name, value in (("parameter_viscous_coefficient", 4.0), ("gcv", 11.0)):
        values = noted[0][name].to_numpy()
        assert values[0, 1] == value
        assert np.isnan(np.delete(values.reshape(-1), 1)).all()
    assert noted[0]["parameter_viscous_coefficient"].attrs["units"] == "N s m-1"


def test_a_term_without_weight_has_no_value():
    grid = WeightGrid.of({"force": [1.0]}, ["force", "torque"])
    declared = formulation().with_weights(torque=0.0)
    record = path_dataset.PathRecord(declared, grid, {}, 1e-6)
    record.add((0,), tt.Fitter(declared.with_weights(force=1.0)).solve())
    values = record.dataset()["term_value"].isel(force_weight=0)
    assert np.isnan(values.sel(term="torque")) and values.sel(term="force") > 0.0


def test_forces_alone_leave_torques_out():
    own = scene()
    bare = replace(own, trajectory=replace(own.trajectory, torque=None))
    grid = WeightGrid.of({"force": [1.0]}, ["force"])
    declared = load("eq10", bare).with_weights(force=1.0)
    record = path_dataset.PathRecord(declared, grid, {}, 1e-6)
    record.add((0,), tt.Fitter(declared).solve())
    found = record.dataset()
    assert np.isfinite(found["force_residual"]).all()
    assert np.isnan(found["torque_residual"]).all()


def test_everything_has_a_unit_and_says_where_it_is_from(noted):
    found = noted[0]
    assert all("units" in variable.attrs for variable in found.variables.values())
    assert found["r"].attrs["units"] == "m" and found["theta"].attrs["units"] == "rad"
    assert "eq10" in found.attrs["formulation"]
    assert found.attrs["tolerance"] == 1e-6


def test_a_common_weight_stands_on_one_axis():
    names = ("force", "torque")
    grid = WeightGrid.of({names: FORCE}, names)
    found = path_dataset.PathRecord(formulation(), grid, {}, 1e-6).dataset()
    assert found["torque_weight"].dims == ("force_weight",)
    np.testing.assert_array_equal(found["torque_weight"], FORCE)


def test_a_file_gives_it_back(noted, tmp_path):
    found, file = noted[0], tmp_path / "path.nc"
    path_dataset.write_solution_path(found, file)
    again = path_dataset.read_solution_path(file)
    assert again.drop_attrs().equals(found.drop_attrs())
    for name in ("force_residual", "status", "gcv"):
        assert set(again[name].attrs) >= set(found[name].attrs)
    assert again.attrs["formulation"] == found.attrs["formulation"]
    for lost in ("objective", "status", "term_value"):
        path_dataset.write_solution_path(found.drop_vars(lost), file)
        refuses(
            FileError, "damaged solution path", path_dataset.read_solution_path, file
        )


def test_the_best_weights_have_the_smallest_mean_error(noted):
    found = noted[0]
    assert "two" in found["held_out"]
    name = "held_out_force_magnitude_error"
    errors = np.array([[[1.0, 9.0], [4.0, 5.0]], [[np.nan, np.nan], [3.0, 8.0]]])
    given = found.assign({name: (found[name].dims, errors)})
    assert path_dataset.best_weights(given) == {"force": FORCE[0], "torque": TORQUE[1]}
    nothing = found.assign({name: (found[name].dims, np.full((2, 2, 2), np.nan))})
    assert path_dataset.best_weights(nothing) == {}
    assert path_dataset.best_weights(found.drop_dims("held_out")) == {}
