"""The comparator of the documentation works as it stands there."""

import re
from pathlib import Path

import numpy as np

from tests.comparators.recordings import fitted, recordings
from tests.conftest import ellipsoid, torso
from ttus_opt.comparators import available
from ttus_opt.comparators.comparison import judged

PAGE = Path(__file__).resolve().parents[2] / "docs" / "comparators.md"


def test_the_shown_comparator_renders_one_spring():
    code = re.findall(r'```python title=".*?"\n(.*?)```', PAGE.read_text(), re.S)
    names: dict[str, object] = {"__name__": "own"}
    exec(compile(code[0], "comparators.md", "exec"), names)
    kind = names["DeepestPoint"]
    assert callable(kind)
    own = kind(surface=torso(), shell=ellipsoid()).fit(recordings())
    row = judged(own, "slide", recordings()[1])
    other = judged(fitted("signed_distance"), "slide", recordings()[1])
    # both are straight springs along the same direction
    assert abs(row.force_angle_error_deg - other.force_angle_error_deg) < 2.0
    assert np.isfinite(row.ripple)


def test_the_page_has_every_comparator():
    page = PAGE.read_text()
    assert [name for name in available() if f"`{name}`" not in page] == []
