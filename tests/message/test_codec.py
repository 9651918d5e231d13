"""One pair of calls: what is decoded is of the kind that was encoded."""

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError, refuses
from tests.message.patients import dented, fitted, sent, uneven
from ttus_opt.message.codec import decode, encode
from ttus_opt.message.surface_message import MAX_ERROR

pytest.importorskip("pcodec", reason="needs ttus-opt[sensors]")


def test_the_kind_comes_back():
    surface, field = sent()
    assert isinstance(decode(surface), tt.Surface)
    assert isinstance(decode(field, base=surface), tt.PotentialField)
    change = encode(dented(uneven()), base=encode(uneven()))
    assert isinstance(decode(change, base=encode(uneven())), tt.Surface)


def test_several_messages_stand_for_the_last_surface():
    """A list, a tuple, or a message alone where there are no changes."""
    first, later = uneven(), dented(uneven())
    whole = encode(first)
    change = encode(later, base=whole)
    again = encode(first, base=[whole, change])
    for base in ([whole, change], (whole, change)):
        found = decode(again, base=base)
        assert isinstance(found, tt.Surface)
        np.testing.assert_allclose(found.radius, first.radius, atol=MAX_ERROR)
    once = decode(change, base=[whole])
    assert isinstance(once, tt.Surface)
    np.testing.assert_allclose(once.radius, later.radius, atol=MAX_ERROR)
    # the change back goes with the first change, not with the surface alone
    refuses(InputError, "builds on", decode, again, base=whole)


def test_no_bound_is_the_usual_one_and_zero_is_refused():
    assert len(encode(uneven(), max_error=MAX_ERROR)) == len(encode(uneven()))
    refuses(InputError, "", encode, uneven(), max_error=0.0)


def test_what_builds_on_another_is_told():
    surface, field = sent()
    refuses(InputError, "message as base", encode, fitted())
    refuses(InputError, "builds on another", decode, field)
    refuses(InputError, "no base", decode, surface, base=surface)
    refuses(InputError, "base is empty", decode, field, base=[])
