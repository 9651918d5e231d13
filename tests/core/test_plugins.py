"""What a user's code raises is told with its line; what is ours passes as it is."""

import importlib.util
import zipfile
from pathlib import Path

import pytest

import ttus_opt.problem.constraints
import ttus_opt.problem.terms
from tests.kit import InputError, python, refuses
from ttus_opt.core import plugins
from ttus_opt.core.plugins import defined_at, user_errors
from ttus_opt.problem.terms.wrench import ForceTerm


def module(folder, text):
    path = folder / "mine.py"
    path.write_text(text)
    spec = importlib.util.spec_from_file_location("mine", path)
    made = importlib.util.module_from_spec(spec)
    with user_errors("file mine"):
        spec.loader.exec_module(made)
    return made


def test_the_innermost_line_of_the_user(tmp_path):
    text = "import numpy as np\n\ndef rows(n):\n    return np.zeros(n)\n"
    mine = module(tmp_path, text)
    told = r"^rows\(\) raised \w+Error: .* \(.*mine\.py, line 4\)$"
    with pytest.raises(InputError, match=told) as caught, user_errors("rows()"):
        mine.rows(-1)
    assert isinstance(caught.value.__cause__, ValueError)
    assert defined_at(mine.rows).endswith("mine.py, line 3)")
    assert defined_at(ForceTerm.rows) == ""


def test_syntax_errors_and_exits_are_told_too(tmp_path):
    refuses(InputError, r"SyntaxError: .*mine\.py, line 1", module, tmp_path, "def\n")
    with pytest.raises(InputError, match=r"file mine raised SystemExit: 3"):
        module(tmp_path, "import sys\nsys.exit(3)\n")


def test_our_own_errors_pass():
    with pytest.raises(InputError, match=r"^as it is$"), user_errors("anything"):
        raise InputError("as it is")


def test_public_classes_by_the_file_they_stand_in():
    found = plugins.classes_of(ttus_opt.problem.constraints)
    assert found["Sign"].__module__ == "ttus_opt.problem.constraints.signs"
    assert "Bounds" not in found  # imported there, defined elsewhere
    assert not any(name.startswith("_") for name in found)
    assert ttus_opt.problem.constraints.Sign is found["Sign"]


@pytest.mark.parametrize("name", ["Sine", "sign", "_Sign"])
def test_other_names_are_refused(name):
    with pytest.raises(AttributeError, match=f"no attribute '{name}'"):
        getattr(ttus_opt.problem.terms, name)


ROOT = Path(__file__).resolve().parents[2]
SHOW = (
    "from ttus_opt.problem.formulation import available; "
    "print('eq10' in {f.name for f in available()})"
)


@pytest.mark.slow
def test_a_users_own_file_of_that_name_changes_nothing(tmp_path):
    (tmp_path / "formulations.py").write_text("raise SystemExit('not ours')\n")
    script = tmp_path / "run.py"
    script.write_text(SHOW)
    assert python(script, PYTHONPATH=str(ROOT)).stdout == "True\n"


@pytest.mark.slow
def test_a_wheel_carries_them_inside_the_package(tmp_path):
    """Built and unpacked: no other top-level package, and eq10 is found."""
    build = ["-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir"]
    python(*build, tmp_path, ROOT)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        tops = {name.split("/")[0] for name in archive.namelist()}
        archive.extractall(tmp_path / "site")
    assert {top for top in tops if not top.endswith(".dist-info")} == {"ttus_opt"}
    shown = python("-c", SHOW, cwd=tmp_path, PYTHONPATH=str(tmp_path / "site"))
    assert shown.stdout == "True\n", shown.stderr
