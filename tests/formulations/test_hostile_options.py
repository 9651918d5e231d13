"""Every numeric option of every formulation: refused in a line, or fitted in truth."""

import importlib
import inspect

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError, refuses, small_scene
from ttus_opt.problem.formulation import available, load
from ttus_opt.problem.verify.kkt import kkt_residuals

SCENE = small_scene("trilinear", shape=(6, 10, 6), n_poses=6)

FORMULATIONS = [info.name for info in available()]


def numeric_options(formulation):
    """Options that take a number, by their annotation."""
    build = importlib.import_module(f"formulations.{formulation}").build
    parameters = inspect.signature(build).parameters.values()
    return [p.name for p in parameters if {"float", "int"} & words(p.annotation)]


def words(annotation):
    """The types an annotation names: ``float | None`` names two."""
    told = annotation.__name__ if isinstance(annotation, type) else str(annotation)
    return {word.strip() for word in told.split("|")}


def test_the_table_is_whole():
    assert numeric_options("eq10") == [
        "force_weight",
        "torque_weight",
        "torque_length",
        "direction_error",
    ]
    assert numeric_options("laplace_only") == []
    assert "reference" not in numeric_options("tikhonov")
    told = {
        (info.name, option)
        for info in available()
        for option, default in info.options.items()
        if default is None
        or (isinstance(default, int | float) and not isinstance(default, bool))
    }
    tabled = {
        (info.name, option)
        for info in available()
        for option in numeric_options(info.name)
    }
    assert told == tabled


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_an_option_that_is_no_number_is_refused(formulation):
    for option in numeric_options(formulation):
        for value in (np.nan, np.inf, -np.inf, "heavy"):
            given = {option: value}

            def compiled(given=given):
                return load(formulation, SCENE, **given).compile()

            assert str(value) in refuses(InputError, "", compiled)


#: Numbers that no laboratory would give, and which are numbers all the same
EXTREMES = (0, -1.0, 1e-300, 1e-12, 1e9, 1e15)


def solved_or_told(formulation, option, value):
    """A fit ends in an InputError of one line, or in a status that is true."""
    try:
        found = tt.fit(SCENE, formulation, time_limit=2.0, **{option: value})
    except InputError as refused:
        assert "\n" not in str(refused)
        return
    if found.status is not tt.Status.SOLVED:
        assert found.verified_field is None
        return
    assert found.candidate is not None and np.isfinite(found.candidate).all()
    again = kkt_residuals(found.program, found.candidate, found.duals)
    assert again.worst_relative <= 1e-6


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # inside solvers, as they fail
@pytest.mark.filterwarnings("ignore::ttus_opt.core.errors.TtusWarning")
@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_extreme_numbers(formulation):
    for option in numeric_options(formulation):
        for value in EXTREMES:
            solved_or_told(formulation, option, value)


@pytest.mark.parametrize("formulation", ["depth_map", "depth_map_coulomb"])
@pytest.mark.parametrize("value", EXTREMES)
def test_a_depth_map_of_no_sensible_size_is_refused(formulation, value):
    told = {"deviation", "surface_length", "depth_length"}
    for option in told.intersection(numeric_options(formulation)):
        refuses(InputError, option, load, formulation, SCENE, **{option: value})
