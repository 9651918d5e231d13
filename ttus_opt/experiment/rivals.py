"""Comparators on the same recordings.

`ttus_opt.comparators` is imported on demand. Rows of a comparator have its name after
`PREFIX`, because some are formulations as well.
"""

from __future__ import annotations

import time

import numpy as np

from ttus_opt.core.errors import TtusError
from ttus_opt.experiment.fits import AGAINST, FITTED, Fitted, PatientFits
from ttus_opt.experiment.scores import Row
from ttus_opt.report.metrics import as_rendered, compare

#: Begins the setting of a comparator's rows
PREFIX = "comparator "


def rival(fits: PatientFits, name: str) -> Fitted:
    """Fit and evaluate one comparator, or read the saved result."""
    file, inputs = fits.folder / f"rival-{name}.json", {"digest": fits.digest}
    return Fitted.once(
        name, file, {**inputs, "rival": name}, lambda: _judged(fits, name)
    )


def _judged(fits: PatientFits, name: str) -> Fitted:
    from ttus_opt.comparators import create
    from ttus_opt.comparators.comparison import ripple, timed_wrenches

    examined = fits.examination
    begin = time.process_time()
    try:
        model = create(
            name,
            surface=examined.surface,
            shell=fits.shell,
        )
        model.fit([examined.measured[recording] for recording in FITTED])
    except TtusError as error:
        return Fitted(name, (), {"failure": str(error)})
    spent = time.process_time() - begin
    rows: list[Row] = []
    per_frame = []
    for against in AGAINST:
        for recording, recorded in getattr(examined, against).items():
            wrench, frame = timed_wrenches(model, recorded)
            per_frame.append(frame)
            errors = compare(recorded, as_rendered(wrench))
            rows.append(fits.row(PREFIX + name, recording, against, errors))
    facts = {
        "ms_per_frame": 1e3 * float(np.median(per_frame)),
        "ripple": ripple(model, examined.true["sweep_test"]),
        "processor_seconds": round(spent, 2),
    }
    return Fitted(name, tuple(rows), facts)
