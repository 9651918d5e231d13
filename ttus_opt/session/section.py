"""A section of a session's description; every error names file and key."""

from __future__ import annotations

import difflib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError, TtusError
from ttus_opt.probe.rigid_motion import read_rigid_motion, rigid_motion


@dataclass(frozen=True)
class Section:
    """A mapping within a description.

    Attributes:
        file: The description.
        place: Such as ``tracker``; empty for the whole description.
        values: By name.
    """

    file: Path
    place: str
    values: Mapping[str, Any]

    def fail(self, key: str, what: str) -> FileError:
        """The error for a key."""
        where = ".".join(part for part in (self.place, key) if part)
        return FileError(f"{self.file}: {where} {what}")

    def require_known(self, known: Sequence[str]) -> None:
        """Refuse unknown keys.

        Raises:
            FileError: A key is unknown; the message suggests the nearest known one.
        """
        for key in self.values:
            if key not in known:
                near = difflib.get_close_matches(str(key), known, n=1)
                hint = f"did you mean {near[0]}?" if near else ""
                choices = f"choose from {', '.join(known)}"
                raise self.fail(str(key), f"is not known: {hint or choices}")

    def __contains__(self, key: str) -> bool:
        """Whether a key has a value."""
        return self.values.get(key) is not None

    def get(self, key: str, default: Any = None) -> Any:
        """A value, or its default; `FileError` where neither is there."""
        value = self.values[key] if key in self else default
        if value is None:
            raise self.fail(key, "is missing: add it")
        return value

    def section(self, key: str) -> Section:
        """A subsection; an empty one where it is missing.

        Raises:
            FileError: It is not a mapping of names.
        """
        value = self.get(key, {})
        if not isinstance(value, Mapping):
            raise self.fail(key, f"must map names to values, got {value!r}")
        odd = [name for name in value if not isinstance(name, str)]
        if odd:
            raise self.fail(key, f"has {odd[0]!r} for a name: put it in quotes")
        place = f"{self.place}.{key}" if self.place else key
        return Section(self.file, place, value)

    def text(self, key: str, default: str | None = None) -> str:
        """A non-empty text; `FileError` where it is not, or missing without default."""
        value = self.get(key, default)
        if not isinstance(value, str) or not value:
            raise self.fail(key, f"must be a text, got {value!r}")
        return value

    def choice(self, key: str, words: Sequence[str], default: str | None = None) -> str:
        """One of the given words; `FileError` for any other."""
        word = self.text(key, default)
        if word not in words:
            raise self.fail(key, f"must be {' or '.join(words)}, got {word!r}")
        return word

    def flag(self, key: str) -> bool:
        """True or false, by default false; `FileError` for any other value."""
        value = self.values.get(key, False)
        if not isinstance(value, bool):
            raise self.fail(key, f"must be true or false, got {value!r}")
        return value

    def number(self, key: str, default: float | None = None) -> float:
        """A finite number; `FileError` where it is not, or missing without default."""
        return self._number(key, self.get(key, default))

    def numbers(
        self, key: str, count: int, default: Sequence[float] | None = None
    ) -> tuple[float, ...]:
        """``count`` finite numbers; `FileError` for any other value, or none at all."""
        value = self.get(key, default and list(default))
        if not isinstance(value, list) or len(value) != count:
            raise self.fail(key, f"must be a list of {count} numbers, got {value!r}")
        return tuple(self._number(key, each) for each in value)

    def whole(
        self, key: str, count: int, default: Sequence[int] | None = None
    ) -> tuple[int, ...]:
        """``count`` whole numbers; `FileError` as `numbers`, or for a fraction."""
        values = self.numbers(key, count, default)
        if any(value != round(value) for value in values):
            raise self.fail(key, f"must be whole numbers, got {list(values)}")
        return tuple(int(value) for value in values)

    def path(self, key: str) -> Path:
        """An existing file or folder beside the description; `FileError` if missing."""
        return self._existing(key, self.text(key))

    def paths(self, key: str) -> tuple[Path, ...]:
        """One or several such files; `FileError` if one is missing."""
        value = self.get(key)
        names = value if isinstance(value, list) else [value]
        if not names or not all(isinstance(name, str) and name for name in names):
            raise self.fail(key, f"must be a file or a list of files, got {value!r}")
        return tuple(self._existing(key, name) for name in names)

    def motion(self, key: str) -> Array:
        """A rigid motion (4, 4) [–, m]: a file, x,y,z,qx,qy,qz,qw, or a matrix's rows.

        Raises:
            FileError: It is not a rigid motion.
        """
        return self._motion(key, self.get(key))

    def motions(self, key: str) -> tuple[Array, ...]:
        """A list of such motions; `FileError` if it is empty or one is invalid."""
        value = self.get(key)
        if not isinstance(value, list) or not value:
            raise self.fail(key, f"must be a list of rigid motions, got {value!r}")
        return tuple(self._motion(key, each) for each in value)

    def _motion(self, key: str, value: Any) -> Array:
        try:
            if isinstance(value, list):
                flat = np.array(value, dtype=np.float64)
                if flat.shape == (4, 4):
                    return rigid_motion(flat)
                return read_rigid_motion(json.dumps(flat.reshape(-1).tolist()))
            if not isinstance(value, str):
                raise ValueError
            if (self.file.parent / value).is_file():
                return read_rigid_motion(self.file.parent / value)
            return read_rigid_motion(value)
        except FileError:
            raise
        except (TtusError, ValueError, TypeError) as error:
            reason = error if isinstance(error, TtusError) else f"got {value!r}"
            raise self.fail(key, f"is not a rigid motion: {reason}") from error

    def _number(self, key: str, value: Any) -> float:
        try:
            number = float(value)
        except (TypeError, ValueError, OverflowError):
            number = math.nan
        # YAML 1.1 reads 1e-2 as a text
        if isinstance(value, bool) or not math.isfinite(number):
            raise self.fail(key, f"must be a finite number, got {value!r}")
        return number

    def _existing(self, key: str, name: str) -> Path:
        place = self.file.parent / name
        try:
            there = place.exists()
        except (OSError, ValueError):  # a name that no file may have
            there = False
        if not there:
            raise self.fail(key, f"is {name}, which is not in {self.file.parent}")
        return place
