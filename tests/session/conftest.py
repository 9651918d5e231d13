"""A copy of the recording, to be spoilt."""

import pytest

from tests.session.recordings import copied


@pytest.fixture
def recording(tmp_path):
    return copied(tmp_path)
