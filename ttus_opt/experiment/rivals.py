"""Other ways from measurements to forces, on the same recordings.

Needs the room `ttus_opt.comparators`, which is imported here only, when asked for.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ttus_opt.errors import TtusError
from ttus_opt.experiment.fits import (
    AGAINST,
    FITTED,
    PatientFits,
    as_rendered,
    read_kept,
    write_kept,
)
from ttus_opt.experiment.scores import Row
from ttus_opt.report.metrics import compare


@dataclass(frozen=True)
class Rival:
    """A comparator on one patient.

    Attributes:
        name: Its name.
        rows: Its errors; none where it could not be fitted.
        facts: ``ms_per_frame``, ``ripple`` [–], ``processor_seconds`` of its fit, and
            ``failure`` where there is one.
    """

    name: str
    rows: tuple[Row, ...] = field(repr=False)
    facts: Mapping[str, Any]


def names() -> tuple[str, ...]:
    """The comparators there are."""
    return tuple(_room().available())


def rival(fits: PatientFits, name: str, folder: Path, digest: str) -> Rival:
    """Fit and judge one comparator, or read what an earlier call kept."""
    file, told = folder / f"rival-{name}.json", {"digest": digest, "rival": name}
    kept = read_kept(file, told)
    if kept is None:
        found = _judged(fits, name)
        rows = [row.as_dict() for row in found.rows]
        write_kept(file, {**told, "facts": found.facts, "rows": rows})
        return found
    rows_kept = tuple(Row.from_dict(row) for row in kept["rows"])
    return Rival(name, rows_kept, kept["facts"])


def _judged(fits: PatientFits, name: str) -> Rival:
    examined = fits.examination
    begin = time.process_time()
    try:
        model = _room().create(
            name,
            surface=examined.surface,
            shell=fits.shell,
            cloud=examined.surface.points().reshape(-1, 3),
        )
        model.fit([examined.measured[recording] for recording in FITTED])
    except TtusError as error:
        return Rival(name, (), {"failure": str(error)})
    spent = time.process_time() - begin
    rows: list[Row] = []
    per_frame = []
    for against in AGAINST:
        for recording, own in getattr(examined, against).items():
            begin = time.process_time()
            wrench = np.asarray(model.wrenches(own))
            per_frame.append((time.process_time() - begin) / len(own))
            errors = compare(own, as_rendered(wrench))
            rows.append(fits.row(name, recording, against, errors))
    ripple = importlib.import_module("ttus_opt.comparators.comparison").ripple
    facts = {
        # the median: the first call may compile
        "ms_per_frame": 1e3 * float(np.median(per_frame)),
        "ripple": float(ripple(model, examined.true["sweep_test"])),
        "processor_seconds": round(spent, 2),
    }
    return Rival(name, tuple(rows), facts)


def _room() -> Any:
    return importlib.import_module("ttus_opt.comparators")
