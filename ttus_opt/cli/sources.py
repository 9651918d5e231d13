"""Where a field came from: what `fit` writes, and what other commands check.

The provenance of a field file has texts by key. ``probe``, ``trajectories``,
``surface`` are names; ``recordings`` and ``hashes`` are JSON objects of file names and
SHA-256 sums; ``conventions``, ``options`` and ``versions`` are JSON objects too.
``contacts`` is what `ttus_opt.report.extrapolation` writes of the fitted places.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ttus_opt.core import io
from ttus_opt.core.errors import FileError, MistakeWarning, warn

if TYPE_CHECKING:
    from ttus_opt.cli.recording_options import ProbeOptions, RecordingOptions
    from ttus_opt.probe.point_shell import PointShell
    from ttus_opt.probe.trajectory import Trajectory
    from ttus_opt.scan.surface import Surface

#: Packages that a field's numbers depend on
PACKAGES = ("ttus-opt", "numpy", "scipy", "numba")

#: Options that say nothing of the field
NOT_OF_THE_FIELD = (
    *("output", "json", "force", "picture", "uncertainty_picture"),
    *("verbose", "quiet"),
)


def sources(
    surface: Path,
    probe: ProbeOptions,
    recordings: RecordingOptions,
    typed: Mapping[str, Any],
) -> dict[str, str]:
    """What a field file says of where the field came from.

    Args:
        surface: The surface file.
        probe: The probe.
        recordings: The recordings.
        typed: Every option of the command by name, defaults included.
    """
    import platform

    from ttus_opt.core.optional import version_of

    files = [surface, *([Path(probe.probe)] if ":" not in probe.probe else [])]
    options = {k: v for k, v in typed.items() if k not in NOT_OF_THE_FIELD}
    versions = {name: version_of(name) for name in PACKAGES}
    return {
        "probe": probe.name,
        "surface": surface.name,
        "trajectories": ", ".join(recordings.names),
        "recordings": _hashes(recordings.trajectory),
        "hashes": _hashes(files),
        "conventions": json.dumps(asdict(recordings.conventions)),
        "options": json.dumps(options, default=str),
        "versions": json.dumps({"python": platform.python_version(), **versions}),
    }


def fitted_contacts(
    surface: Surface, shell: PointShell, recorded: Trajectory
) -> dict[str, str]:
    """What a field file says of the places that it was fitted to."""
    from ttus_opt.report.extrapolation import Contacts, FittedContacts

    found = FittedContacts.of(Contacts.of(surface, shell, recorded))
    return {} if found is None else {"contacts": found.text}


def seen(
    provenance: Mapping[str, str], recordings: Sequence[Path]
) -> list[dict[str, Any]]:
    """Name and hash of recordings, and whether the field was fitted to them.

    Args:
        provenance: Provenance of the field.
        recordings: Files of the recordings.

    Raises:
        FileError: The provenance is damaged.
    """
    fitted = _read(provenance, "recordings").values()
    named = [(path.name, io.sha256(path)) for path in recordings]
    return [{"name": n, "sha256": h, "seen": h in fitted} for n, h in named]


def probe_for(
    provenance: Mapping[str, str], probe: ProbeOptions, recordings: RecordingOptions
) -> PointShell:
    """The given probe; a warning tells where a field had another or other torques.

    Args:
        provenance: Provenance of the field.
        probe: The given probe.
        recordings: The given recordings.

    Raises:
        FileError: The provenance is damaged.
        InputError: The probe cannot be read.
    """
    shell = probe.read()
    fitted = provenance.get("probe")
    difference = f"probe {fitted}, this is {probe.name}" if fitted != probe.name else ""
    file = Path(probe.probe)
    if not difference and ":" not in probe.probe:
        own = _read(provenance, "hashes").get(file.name)
        difference = (
            f"another file {fitted}" if own not in (None, io.sha256(file)) else ""
        )
    if fitted and difference:
        warn(
            f"the field was fitted with {difference}: forces of another probe are a "
            "prediction, not a check",
            kind=MistakeWarning,
        )
    written = _read(provenance, "conventions").get("torque_about")
    about = tuple(written) if isinstance(written, list) else written
    own_about = recordings.conventions.torque_about
    if about and about != own_about:
        warn(
            f"the field was fitted to torques about {about}, but these are about "
            f"{own_about}: is --torque-about right?",
            kind=MistakeWarning,
        )
    return shell


def _hashes(files: Sequence[Path]) -> str:
    return json.dumps({path.name: io.sha256(path) for path in files})


def _read(provenance: Mapping[str, str], key: str) -> dict[str, Any]:
    """A JSON object of the provenance; empty where a file has none."""
    try:
        found = json.loads(provenance.get(key, "{}"))
    except (ValueError, TypeError):
        found = None
    if not isinstance(found, dict):
        raise FileError(f"the field file's {key} are damaged: fit the field again")
    return found
