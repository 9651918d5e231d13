"""Names of samplings, and the length that one of them takes."""

from __future__ import annotations

import pytest

from ttus_opt.core.errors import InputError
from ttus_opt.voxmap.sampling import check_sampling, field_unit, least_length, sized


@pytest.mark.parametrize(
    ("name", "length", "unit"),
    [
        ("voxel-mean", 0.0, "N"),
        ("trilinear", 0.0, "N cm-2"),
        ("contact-size", 0.005, "N cm-2"),
        ("contact-size:0.018", 0.018, "N cm-2"),
    ],
)
def test_a_name_has_a_length_and_a_unit(name, length, unit):
    check_sampling(name)
    assert least_length(name) == length and field_unit(name) == unit


def test_a_length_is_written_in_three_digits():
    assert sized(0.0178499) == "contact-size:0.0178"
    assert least_length(sized(1.23456e-4)) == 1.23e-4


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("nearest", "one of voxel-mean, .*contact-size:LENGTH in m, got 'nearest'"),
        ("trilinear:0.01", "got 'trilinear:0.01'"),
        ("contact-size:", "must be 0.0001 to 1 m, got ''"),
        ("contact-size:18", "must be 0.0001 to 1 m, got '18'"),
        ("contact-size:18mm", "got '18mm'"),
        ("contact-size:nan", "got 'nan'"),
    ],
)
def test_other_names_are_refused(name, told):
    with pytest.raises(InputError, match=told):
        check_sampling(name)
