"""What has no name is refused, for nothing could address it."""

import pytest

from tests.conftest import small_scene
from tests.refusals import refuses
from ttus_opt.core.errors import InputError
from ttus_opt.problem.terms.member import Member


class Nameless(Member):
    def rows(self) -> object:
        return None


class Named(Nameless):
    name = "own"


def test_a_class_without_a_name_is_told_what_to_add():
    told = 'Nameless has no name: add name = "…"'
    refuses(InputError, told, lambda: Nameless(small_scene()).name)
    assert Named(small_scene()).name == "own"


def test_rows_have_to_be_stated():
    with pytest.raises(TypeError, match="rows"):
        Member(small_scene())
