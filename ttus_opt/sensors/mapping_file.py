"""Small YAML, JSON or XML files that hold a mapping; OpenCV's YAML and XML too."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any

from ttus_opt.core import io
from ttus_opt.core.errors import FileError, MissingPackageError
from ttus_opt.core.optional import load

#: Largest file [byte]
LARGEST_FILE = 100_000


def read_mapping(path: str | os.PathLike[str], what: str) -> Mapping[str, Any]:
    """The mapping of a YAML or JSON file, plain values only.

    Args:
        path: The file; YAML needs the extra ``sensors``.
        what: What it should be, for the message ("session").

    Raises:
        FileError: Missing, too large, of another kind, or no mapping.
        MissingPackageError: PyYAML is not installed.
    """
    file = io.existing_file(path, what, LARGEST_FILE)
    try:
        text = file.read_text(encoding="utf-8-sig")
        begin = text.lstrip()[:1]
        if begin == "<":
            found = _xml(text)
        elif file.suffix.lower() == ".json" or begin == "{":
            found = json.loads(text)
        else:
            found = _yaml(text)
    except MissingPackageError:
        raise
    except Exception as error:  # the parsers raise nearly every class
        raise FileError(
            f"{file} cannot be read as XML, YAML or JSON{_place(error)}: a {what} is a "
            "mapping of names to values"
        ) from error
    if not isinstance(found, Mapping) or not all(isinstance(k, str) for k in found):
        raise FileError(f"{file} is not a {what}: it must map names to values")
    return found


def _yaml(text: str) -> Any:
    """A YAML text, without the first line that OpenCV writes against the standard."""
    yaml: Any = load("yaml", "sensors")

    class Loader(yaml.SafeLoader):
        """Plain values, and OpenCV's matrices as mappings."""

    Loader.add_constructor(
        "tag:yaml.org,2002:opencv-matrix",
        lambda loader, node: loader.construct_mapping(node, deep=True),
    )
    first, _, rest = text.partition("\n")
    # the line is emptied, not removed, so that an error names the right one
    plain = f"\n{rest}" if first.startswith("%YAML:") else text
    return yaml.load(plain, Loader=Loader)


def _xml(text: str) -> dict[str, Any]:
    """OpenCV's FileStorage: values as text, matrices as mappings with ``data``."""
    from xml.etree import ElementTree

    found: dict[str, Any] = {}
    for node in ElementTree.fromstring(text):
        data = node.find("data")
        words = (node if data is None else data).text or ""
        if data is None:
            found[node.tag] = words.strip().strip('"')
        else:
            found[node.tag] = {"data": [float(word) for word in words.split()]}
    return found


def _place(error: Exception) -> str:
    """The line at which a parser stopped, if it says so."""
    mark = getattr(error, "problem_mark", None)
    line = getattr(error, "lineno", None) if mark is None else mark.line + 1
    return "" if line is None else f" (line {line})"
