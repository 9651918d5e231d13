"""A copy of the recording, to be spoilt."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.session.recordings import copied


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return copied(tmp_path)
