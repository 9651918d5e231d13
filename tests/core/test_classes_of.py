"""A shelf finds the classes of its files, and nothing else."""

import pytest

import ttus_opt.problem.constraints
import ttus_opt.problem.terms
from ttus_opt.core import plugins


def test_public_classes_by_the_file_they_stand_in():
    found = plugins.classes_of(ttus_opt.problem.constraints)
    assert found["Sign"].__module__ == "ttus_opt.problem.constraints.signs"
    assert "Bounds" not in found  # imported there, defined elsewhere
    assert not any(name.startswith("_") for name in found)
    assert plugins.class_of(ttus_opt.problem.constraints, "Sign") is found["Sign"]


@pytest.mark.parametrize("name", ["Sine", "sign", "_Sign"])
def test_other_names_are_refused(name):
    with pytest.raises(AttributeError, match=f"no attribute '{name}'"):
        plugins.class_of(ttus_opt.problem.terms, name)
