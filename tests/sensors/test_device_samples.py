"""The page of devices is what the command says of their samples."""

import pytest


@pytest.mark.slow
def test_the_page_of_devices():
    for needed in ("rosbags", "pyigtl", "yaml"):
        pytest.importorskip(needed, reason="needs ttus-opt[sensors] and pyigtl")
    from tests.sensors.device_samples import PAGE, page

    assert page() == PAGE.read_text(encoding="utf-8")
