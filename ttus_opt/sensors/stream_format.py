"""What a format of recordings is: how it is recognised, and its reader."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from ttus_opt.core.errors import FileError
from ttus_opt.probe.raw_recording import RawRecording

#: Begin of a file by which formats are told apart [byte]
HEAD = 8192


class Wanted(NamedTuple):
    """What is read of a file.

    Attributes:
        name: The only stream that is needed; None for all.
        columns: The file's names of columns, by the package's.
        kind: ``poses``, ``wrenches``, ``recording`` for poses with the wrenches beside
            them, or empty for all.
    """

    name: str | None = None
    columns: Mapping[str, str] = {}
    kind: str = ""


class StreamFormat(NamedTuple):
    """A format of recordings.

    Attributes:
        title: Its name, as a person is told.
        recognises: Whether a file is of it, from its path and the text it begins with.
        read: The file's streams.
        word: What names a stream in it; empty where there is one only.
        has_columns: Whether its columns have names of the user's choice.
    """

    title: str
    recognises: Callable[[Path, str], bool]
    read: Callable[[Path, Wanted], Sequence[RawRecording]]
    word: str = ""
    has_columns: bool = False


def chosen(
    file: Path, found: Sequence[RawRecording], wanted: Wanted, word: str
) -> RawRecording:
    """The stream to read.

    Args:
        file: Its file.
        found: All streams.
        wanted: Its kind, and its name where there are several.
        word: What names a stream: topic, transform, …

    Raises:
        FileError: No such stream, or several to choose from.
    """
    word, kind = word or "stream", wanted.kind.replace("recording", "poses")
    of_kind = [
        raw
        for raw in found
        if (raw.has_wrenches if wanted.kind == "wrenches" else raw.has_poses)
    ]
    if not of_kind:
        other = "poses" if wanted.kind == "wrenches" else "wrenches"
        if found and not any(raw.name for raw in found):
            raise FileError(f"{file} has {other} only, no {kind}: name another file")
        listed = ", ".join(raw.name for raw in found)
        but = f", but {listed}" if listed else ""
        raise FileError(f"{file} has no {word} of {kind}{but}: record one")
    names = [raw.name for raw in of_kind]
    return of_kind[names.index(one_of(file, names, wanted.name, f"{word}s of {kind}"))]


def one_of(file: Path, names: Sequence[str], wanted: str | None, what: str) -> str:
    """The wanted name, or the only one.

    Args:
        file: Their file, for the message.
        names: One or more.
        wanted: None for the only one.
        what: What they are names of: topics of poses, …

    Raises:
        FileError: No such name, or several to choose from.
    """
    if wanted is None and len(names) > 1:
        raise FileError(
            f"{file} has several {what}: {', '.join(names)}: choose one, for instance "
            f"name='{names[0]}'"
        )
    if wanted not in (None, *names):
        one = what.replace("s of ", f" {wanted} of ", 1)
        raise FileError(f"{file} has no {one}: one of {', '.join(names)}")
    return wanted or names[0]
