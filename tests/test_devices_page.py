"""The page from three devices' files to a field says what the commands say."""

import importlib
import re
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"


@pytest.mark.slow
def test_the_transcript_is_what_the_commands_say(tmp_path, monkeypatch):
    """Run anew; the same words, numbers aside, which differ by machine and version."""
    pytest.importorskip("rosbags", reason="needs ttus-opt[sensors]")
    monkeypatch.setattr(sys, "path", [str(DOCS), *sys.path])
    devices = importlib.import_module("devices")
    monkeypatch.chdir(tmp_path)
    lines = "\n".join([devices.HEAD, *devices.transcript(), ""])
    assert words(lines) == words(devices.PAGE.read_text(encoding="utf-8"))


def words(text):
    """The text without numbers and the layout that follows from their widths."""
    return re.sub(r"\s+", " ", re.sub(r"[-+]?\d[\d,.]*(e[-+]?\d+)?", "#", text))
