"""What has no name is refused, for nothing could address it."""

from __future__ import annotations

import pytest

from tests.conftest import small_scene
from ttus_opt.core.errors import InputError
from ttus_opt.problem.terms.member import Member


class Nameless(Member):
    def rows(self) -> object:
        return None


class Named(Nameless):
    name = "own"  # type: ignore[assignment]


def test_a_class_without_a_name_is_told_what_to_add() -> None:
    with pytest.raises(InputError, match='Nameless has no name: add name = "…"'):
        Nameless(small_scene()).name  # noqa: B018
    assert Named(small_scene()).name == "own"


def test_rows_have_to_be_stated() -> None:
    with pytest.raises(TypeError, match="rows"):
        Member(small_scene())  # type: ignore[abstract]
