"""Parts by name."""

from __future__ import annotations

import pytest

from ttus_opt.benchmark.parts.registry import SOLVERS, chosen
from ttus_opt.core.errors import InputError


def test_names() -> None:
    named = ["assembly", "profile", "recursion", "rendering", "ripple"]
    assert chosen("all") == [SOLVERS, *named]
    assert chosen("ripple, solvers,ripple") == ["ripple", SOLVERS]
    for text in ("riple", "", "solvers,all"):
        with pytest.raises(InputError, match="choose from solvers, assembly"):
            chosen(text)
