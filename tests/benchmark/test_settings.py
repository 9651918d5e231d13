"""Which reference is meant."""

import pytest

from ttus_opt.benchmark.settings import AUTO, CLOSED_FORM, Settings


@pytest.mark.parametrize(
    ("asked", "meant"), [(AUTO, CLOSED_FORM), ("", ""), ("structured", "structured")]
)
def test_the_reference(asked, meant):
    assert Settings(closed_form=asked).reference == meant


def test_by_default_it_is_the_closed_form_where_it_fits():
    assert Settings().closed_form == AUTO
