"""Every name the package gives is there, under the paths it has always had."""

import dataclasses
import importlib
import importlib.metadata
import typing

import numpy as np
import pytest
import scipy.sparse as sp

import ttus_opt as tt
from tests import mutants
from tests.kit import refuses
from ttus_opt import example
from ttus_opt.fitting.poses.pose_refinement import RefinedPoses
from ttus_opt.fitting.recursion.recursive import Innovation
from ttus_opt.fitting.uncertainty.field_uncertainty import Uncertainty
from ttus_opt.fitting.uncertainty.next_press import NextPresses
from ttus_opt.haptic.field_wrench import Wrench
from ttus_opt.report.metrics import Evaluation

#: A path and a name that users' files import
KEPT = {
    "ttus_opt.problem.constraints.signs": "Sign",
    "ttus_opt.report.metrics": "evaluate",
    "ttus_opt.report.plots": "overview",
    "ttus_opt.problem.formulation": "Formulation",
    "ttus_opt.contact.scene": "Scene",
    "ttus_opt.scene": "ScenePlan",
    "ttus_opt.solvers.registry": "solvers",
    "ttus_opt.problem.terms.laplace": "LaplaceTerm",
}


#: Public names that are called otherwise where they live
OTHERWISE = {
    "constraints": "ttus_opt.problem.constraints",
    "load_formulation": "load",
    "paper": "ttus_opt.core.paper",
    "plots": "ttus_opt.report.plots",
    "terms": "ttus_opt.problem.terms",
}


@pytest.mark.parametrize("name", tt.__all__)
def test_a_public_name_is_loaded_on_first_use(name):
    assert getattr(tt, name).__name__ == OTHERWISE.get(name, name)


def test_a_shelf_gives_its_classes_by_name():
    from ttus_opt.problem.terms.laplace import LaplaceTerm

    assert tt.terms.LaplaceTerm is LaplaceTerm
    assert {"CvxpyTerm", "ForceTerm"} <= set(dir(tt.terms))
    assert {"Sign", "HardBoundary"} <= set(dir(tt.constraints))
    refuses(AttributeError, "no attribute 'LaplaseTerm'", lambda: tt.terms.LaplaseTerm)


def test_the_version_is_that_of_the_package():
    assert tt.__version__ == importlib.metadata.version("ttus-opt")


@pytest.mark.parametrize("module", KEPT)
def test_a_kept_path_gives_what_it_gave(module):
    assert hasattr(importlib.import_module(module), KEPT[module])


def test_mutants_are_made_of_files_that_are_there():
    listed = mutants.EQUIVALENT.read_text(encoding="utf-8").splitlines()[1:]
    code = {line.split(" | ")[0] for line in listed if line}
    for target in mutants.chosen([]):
        code.add(target.module)
        for test in target.tests:
            assert (mutants.ROOT / "tests" / test).is_file(), test
    for module in code:
        assert (mutants.ROOT / "ttus_opt" / module).is_file(), module


def test_an_unknown_name_is_named():
    refuses(AttributeError, "no attribute 'Surfaces'", lambda: tt.Surfaces)


def arrays_compared(cls, within=""):
    """Fields, of fields too, whose == is that of arrays, of no truth value."""
    if not dataclasses.is_dataclass(cls) or cls.__eq__ is object.__eq__:
        return
    hints = typing.get_type_hints(cls)
    for own in dataclasses.fields(cls):
        name = f"{within}.{own.name}"
        for kind in kinds(hints[own.name]) if own.compare else ():
            if kind is not cls:
                yield from arrays_compared(kind, name)
            if isinstance(kind, type) and issubclass(kind, np.ndarray | sp.sparray):
                yield name


def kinds(hint):
    """The classes in a type."""
    yield typing.get_origin(hint) or hint
    for part in typing.get_args(hint):
        yield from kinds(part)


#: Results that public functions give
RESULTS = (Evaluation, Innovation, NextPresses, RefinedPoses, Uncertainty, Wrench)


@pytest.mark.parametrize(
    "cls",
    [
        *(one for name in tt.__all__ if isinstance(one := getattr(tt, name), type)),
        *(getattr(tt.terms, name) for name in dir(tt.terms) if name[0] != "_"),
        *(getattr(tt.constraints, n) for n in dir(tt.constraints) if n[0] != "_"),
        *RESULTS,
    ],
    ids=lambda cls: cls.__name__,
)
def test_public_objects_are_compared(cls):
    assert not list(arrays_compared(cls, cls.__name__))


def test_a_surface_is_equal_to_itself_alone():
    one, same = (tt.Surface.load(example.path("surface.nc")) for _ in range(2))
    assert one == one and one != same and one in {one} and same not in [one]
