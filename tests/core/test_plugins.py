"""What a user's code raises is told with its line; what is ours passes as it is."""

import importlib.util

import pytest

from tests.refusals import refuses
from ttus_opt.core.errors import InputError
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
