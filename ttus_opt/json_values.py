"""Values as JSON can say them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any


def plain(value: Any) -> Any:
    """Mappings, lists and numbers without NumPy's types; NaN and infinity are null.

    >>> import numpy as np
    >>> plain({"error": np.float64("nan"), "shape": (2, np.int64(3))})
    {'error': None, 'shape': [2, 3]}
    """
    if isinstance(value, Mapping):
        return {str(name): plain(each) for name, each in value.items()}
    if hasattr(value, "tolist"):  # of NumPy, which a command may do without
        value = value.tolist()
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [plain(each) for each in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
