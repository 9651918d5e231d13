"""Errors over boundary values: what is kept comes back as it was."""

import math
from types import SimpleNamespace

from ttus_opt.experiment import boundary
from ttus_opt.experiment.boundary import BoundaryError, boundary_errors


def test_a_fit_that_failed_is_kept_as_one(tmp_path, monkeypatch):
    fits = SimpleNamespace(folder=tmp_path, stamp="word")

    def failed(fits, weight, factor):
        return BoundaryError("lean", factor, 2.0 * factor, 0.5, float("nan"))

    monkeypatch.setattr(boundary, "_at", failed)
    made = boundary_errors(fits, 1.0)
    monkeypatch.setattr(boundary, "_at", None)
    again = boundary_errors(fits, 1.0)
    for one in (*made, *again):
        assert math.isnan(one.after_N) and one.before_N == 0.5
    assert [one.factor for one in again] == [one.factor for one in made]
