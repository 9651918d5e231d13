"""A package that is not installed is named, with the command that installs it."""

import sys

import numpy as np
import pytest

from ttus_opt.core.errors import MissingPackageError
from ttus_opt.core.optional import extra_with, load, version_of


def test_a_missing_package_is_named_with_its_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "skfem", None)
    with pytest.raises(MissingPackageError, match=r'pip install "ttus-opt\[phantom\]"'):
        load("skfem", "phantom")


def test_a_package_that_is_there_is_given():
    assert load("json", "any") is sys.modules["json"]


def test_what_a_package_itself_misses_is_not_hidden(tmp_path, monkeypatch):
    (tmp_path / "lame.py").write_text("import not_there_either\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ModuleNotFoundError, match="not_there_either") as told:
        load("lame", "any")
    assert not isinstance(told.value, MissingPackageError)


def test_the_extra_of_a_module_is_that_of_the_metadata():
    for module, extra in (("msgspec", "live"), ("mcap", "live"), ("viser", "viewer")):
        assert extra_with(module) == extra
    assert extra_with("small_gicp.small") == "sensors"
    assert extra_with("numpy") is None and extra_with("not_there") is None


def test_versions_are_those_installed():
    assert version_of("numpy") == np.__version__
    assert version_of("not-there") == "unknown"
