"""Damage of a file is noticed, and what was left out is not missed."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from ttus_opt.checksum import ATTRIBUTE, check_content, with_checksums
from ttus_opt.errors import InputError


def dataset() -> xr.Dataset:
    return with_checksums(
        xr.Dataset(
            {"p": ("x", np.arange(4.0), {"units": "N"}), "name": ("x", list("abcd"))},
            coords={"x": ("x", [1, 2, 3, 4])},
            attrs={"kind": "field", "version": 1},
        )
    )


def test_what_was_written_passes() -> None:
    check_content(dataset())
    check_content(dataset().drop_vars("p"), ["p"])
    again = dataset().assign_attrs(version=np.int64(1))  # as a file gives it
    check_content(again)


@pytest.mark.parametrize("name", ["p", "name", "x"])
def test_a_changed_value_is_named(name: str) -> None:
    changed = dataset()
    values = changed[name].values.copy()
    values[2] = values[1]
    changed[name] = (("x",), values, changed[name].attrs)
    with pytest.raises(InputError, match=f"^{name} is not what was written"):
        check_content(changed)


def test_changed_attributes_and_missing_variables_are_named() -> None:
    changed = dataset()
    changed["p"].attrs["units"] = "kN"
    with pytest.raises(InputError, match=r"^p is not"):
        check_content(changed)
    with pytest.raises(InputError, match=r"^p is not"):
        check_content(dataset().drop_vars("p"))
    with pytest.raises(InputError, match=r"^an attribute is not"):
        check_content(dataset().assign_attrs(version=2))
    for damaged in ("{", "[1]", 7):
        with pytest.raises(InputError, match="checksums are damaged"):
            check_content(dataset().assign_attrs({ATTRIBUTE: damaged}))
