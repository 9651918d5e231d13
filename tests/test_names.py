"""Every name the package gives is there, under the paths it has always had."""

from __future__ import annotations

import importlib

import pytest

import ttus_opt as tt

#: A public path and a name it gives; users' files import them.
KEPT = {
    "ttus_opt.constraints.sign": "Sign",
    "ttus_opt.friction": "coulomb_rows",
    "ttus_opt.metrics": "evaluate",
    "ttus_opt.plots": "overview",
    "ttus_opt.problem.formulation": "Formulation",
    "ttus_opt.scene": "Scene",
    "ttus_opt.solvers.registry": "solvers",
    "ttus_opt.terms.laplace": "LaplaceTerm",
}


@pytest.mark.parametrize("name", tt.__all__)
def test_a_public_name_is_loaded_on_first_use(name: str) -> None:
    assert getattr(tt, name).__name__ == name


@pytest.mark.parametrize("module", KEPT)
def test_a_kept_path_gives_what_it_gave(module: str) -> None:
    assert hasattr(importlib.import_module(module), KEPT[module])


def test_an_unknown_name_is_named() -> None:
    with pytest.raises(AttributeError, match="no attribute 'Surfaces'"):
        tt.Surfaces  # noqa: B018
