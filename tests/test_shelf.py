"""A shelf finds the classes of its files, and nothing else."""

from __future__ import annotations

import pytest

import ttus_opt.constraints
import ttus_opt.terms
from ttus_opt import shelf


def test_public_classes_by_the_file_they_stand_in() -> None:
    found = shelf.members(ttus_opt.constraints)
    assert found["Sign"].__module__ == "ttus_opt.constraints.sign"
    assert "Bounds" not in found  # imported there, defined elsewhere
    assert not any(name.startswith("_") for name in found)
    assert shelf.member(ttus_opt.constraints, "Sign") is found["Sign"]


@pytest.mark.parametrize("name", ["Sine", "sign", "_Sign"])
def test_other_names_are_refused(name: str) -> None:
    with pytest.raises(AttributeError, match=f"no attribute '{name}'"):
        shelf.member(ttus_opt.terms, name)
