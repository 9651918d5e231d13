"""A short synthetic recording on a coarse grid, and its description to be spoilt."""

from __future__ import annotations

import functools
import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

from ttus_opt.session.synthetic import write_recording

#: Of each of the example's recordings [s]
SECONDS = 5.0


@functools.cache
def made() -> Path:
    """The recording, made once for a process."""
    folder = Path(tempfile.mkdtemp(prefix="ttus-session-"))
    write_recording(folder, seconds=SECONDS, shape=(12, 24, 12))
    return folder


def copied(folder: Path) -> Path:
    """A copy of one's own."""
    return Path(shutil.copytree(made(), folder / "recording"))


def described(recording: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((recording / "session.json").read_text())
    return content


def rewrite(recording: Path, content: dict[str, Any]) -> None:
    (recording / "session.json").write_text(json.dumps(content))


def changed(recording: Path, key: str, value: Any) -> None:
    """Set one value of a description by its dotted key; None takes it out."""
    content = described(recording)
    at = content
    *path, last = key.split(".")
    for name in path:
        at = at.setdefault(name, {})
    if value is None:
        at.pop(last, None)
    else:
        at[last] = value
    rewrite(recording, content)
