"""Conversion of values to what JSON can represent."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any


def plain(value: Any) -> Any:
    """Convert to dicts, lists and Python numbers; NaN and infinity become None.

    >>> import numpy as np
    >>> plain({"error": np.float64("nan"), "shape": (2, np.int64(3))})
    {'error': None, 'shape': [2, 3]}
    """
    if isinstance(value, Mapping):
        return {str(name): plain(each) for name, each in value.items()}
    if hasattr(value, "tolist"):  # NumPy, without importing it
        value = value.tolist()
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [plain(each) for each in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
