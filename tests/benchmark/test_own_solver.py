"""A user's own solver: by path and as an object, to another process and back."""

import json

import pytest

from tests.benchmark.tiny import tiny_suite
from tests.refusals import refuses
from ttus_opt.benchmark.own_solver import options_of, solver_of
from ttus_opt.core.errors import InputError
from ttus_opt.solvers.packages.closed_form import ClosedForm

FILE = """
from ttus_opt.solvers.packages.closed_form import ClosedForm

class Mine(ClosedForm):
    name = "mine"

SOLVERS = [Mine()]
"""


class Renamed(ClosedForm):
    """An object of an importable class."""

    name = "renamed"


def own_file(folder):
    path = folder / "mine.py"
    path.write_text(FILE)
    return path


def test_a_file_and_an_object_come_back_from_json(tmp_path):
    path = own_file(tmp_path)
    for given, name in ((str(path), "mine"), (path, "mine"), (Renamed(), "renamed")):
        options = json.loads(json.dumps(options_of(given)))
        assert options["solver"] == name
        found = solver_of(options)
        assert found != "auto"
        assert found.name == name
    assert options_of("osqp") == {"solver": "osqp"}
    before = options_of(path)
    path.write_text(FILE + "# another version\n")
    assert options_of(path) != before


def test_auto_is_a_solver_of_its_own():
    assert options_of("auto") == {"solver": "auto"}
    assert solver_of({"solver": "auto"}) == "auto"


def test_what_cannot_travel_is_refused(tmp_path):
    class Local(ClosedForm):
        name = "local"

    refuses(InputError, "give its path", options_of, Local())
    clash = tmp_path / "clash.py"
    clash.write_text(FILE.replace('"mine"', '"osqp"'))
    refuses(InputError, "another name", options_of, clash)
    refuses(InputError, "not found", options_of, tmp_path / "gone.py")


@pytest.mark.slow
def test_both_are_measured(tmp_path):
    own = [own_file(tmp_path), Renamed()]
    found = tiny_suite(tmp_path / "out", solvers=own).run()["solvers"]
    assert [(row["solver"], row["status"]) for row in found] == [
        (name, "solved") for name in ("closed_form", "mine", "renamed")
    ]
    assert all(row["difference_from_closed_form"] < 1e-9 for row in found)
