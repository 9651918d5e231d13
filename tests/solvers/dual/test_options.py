"""Ranges of the numbers of the method, and what an ablation tries of them."""

from __future__ import annotations

import inspect
import time
from dataclasses import fields

import pytest

from ttus_opt.core.errors import InputError
from ttus_opt.solvers.dual.options import Accuracy, DualOptions


@pytest.mark.parametrize("option", fields(DualOptions), ids=lambda f: f.name)
def test_a_number_is_kept_in_its_range(option) -> None:  # type: ignore[no-untyped-def]
    low, high = option.metadata["range"]
    assert low <= option.default <= high
    for trial in (low, high, *option.metadata["trials"]):
        assert getattr(DualOptions(**{option.name: trial}), option.name) == trial
    for outside in (low - 1, high + 1 if high < 1e299 else float("inf")):
        with pytest.raises(InputError, match=f"{option.name} must lie between"):
            DualOptions(**{option.name: outside})
    assert option.default not in option.metadata["trials"]
    assert f"\n    {option.name}:" in (inspect.getdoc(DualOptions) or "")


def test_a_deadline_passes() -> None:
    now = time.perf_counter()
    assert not Accuracy(1e-8).late
    assert not Accuracy(1e-8, deadline=now + 60.0).late
    assert Accuracy(1e-8, deadline=now - 1.0).late
