"""One base for all errors, each also what Python calls that kind of fault."""

import inspect

import pytest

from ttus_opt.core import errors

KINDS = {
    "InputError": ValueError,
    "GeometryError": errors.InputError,
    "FileError": OSError,
    "MissingPackageError": ImportError,
    "SolverUnavailableError": errors.MissingPackageError,
    "NumericalError": ArithmeticError,
}


@pytest.mark.parametrize("name", KINDS)
def test_an_error_is_caught_as_what_it_is(name):
    kind = getattr(errors, name)
    for caught in (errors.TtusError, KINDS[name]):
        with pytest.raises(caught, match="what to do"):
            raise kind("what to do")


def test_no_error_is_left_out():
    own = {
        name
        for name, kind in inspect.getmembers(errors, inspect.isclass)
        if issubclass(kind, Exception) and not issubclass(kind, Warning)
    }
    assert own == {*KINDS, "TtusError"}
    assert issubclass(errors.TtusWarning, UserWarning)
