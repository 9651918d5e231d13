"""Programs of our own never execute what lies in the current folder."""

import os
import subprocess

import pytest

from ttus_opt.core.child_process import SAFE, environment, python_module, safe_path


@pytest.mark.slow
def test_a_file_named_as_a_package_is_not_executed(tmp_path, monkeypatch):
    """Neither by a child, nor by what an interactive session or that child starts."""
    (tmp_path / "numba.py").write_text("open('executed', 'w').close()")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend("")
    command = python_module("ttus_opt.laplace.multigrid.kernels")
    alone = {**environment(), SAFE: ""}  # by the command, or by the environment, alone
    subprocess.run(command, env=alone, check=True)
    plain = [word for word in command if word != "-P"]
    subprocess.run(plain, env=environment(), check=True)
    assert not (tmp_path / "executed").exists()


def test_a_class_beside_a_script_is_found(tmp_path, monkeypatch):
    (tmp_path / "my_own_solver.py").write_text("")
    monkeypatch.chdir(tmp_path)
    subprocess.run(python_module("my_own_solver"), env=environment(), check=True)


@pytest.mark.parametrize("before", [None, "1"])
def test_the_word_for_other_libraries_is_taken_back(before, monkeypatch):
    monkeypatch.delenv(SAFE, raising=False)
    if before is not None:
        monkeypatch.setenv(SAFE, before)
    with safe_path():
        assert os.environ[SAFE] == "1"
    assert os.environ.get(SAFE) == before
