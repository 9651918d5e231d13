"""Mutations of sound files: a reader raises the package's own errors and no other."""

import resource

import numpy as np
import pytest

from ttus_opt.core.errors import TtusError, TtusWarning

SEED = 20261122

#: How many mutations: a few each time, 2,000 with the slow tests, 10,000 with the long
NUMBERS = [
    pytest.param(60),
    pytest.param(2_000, marks=pytest.mark.slow),
    pytest.param(10_000, marks=[pytest.mark.slow, pytest.mark.long]),
]


def mutated(content, rng):
    """A few bytes changed, taken out, doubled, or the end cut off."""
    data = bytearray(content)
    for _ in range(int(rng.integers(1, 5))):
        if not data:
            break
        # headers are where readers are led astray
        reach = min(len(data), 400) if rng.random() < 0.7 else len(data)
        at, span = int(rng.integers(reach)), int(rng.integers(1, 12))
        match int(rng.integers(5)):
            case 0:
                data[at : at + span] = rng.bytes(span)
            case 1:
                del data[at : at + span]
            case 2:
                data[at:at] = data[at : at + span]
            case 3:
                data[at : at + span] = b"9" * span
            case _:
                del data[at + 1 :]
    return bytes(data)


def only_our_errors(sources, read, n):
    """Read n mutations; their number and the seed are told where one misbehaves.

    A file as it is must be read: else its name alone, or its place, is refused.
    """
    rng = np.random.default_rng(SEED)
    # the netCDF library keeps one in four damaged files open
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    contents = [source.read_bytes() for source in sources]
    for source, content in zip(sources, contents, strict=True):
        read(_anew(source, content))
    for number in range(n):
        chosen = int(rng.integers(len(sources)))
        file = _anew(sources[chosen], mutated(contents[chosen], rng))
        try:
            read(file)
        except (TtusError, TtusWarning) as error:
            assert "\n" not in str(error)
        except Exception as error:
            name = sources[chosen].name
            raise AssertionError(f"seed {SEED}, mutation {number} of {name}") from error


def _anew(source, content):
    """A new file: HDF5 may hold a damaged one open, and answer by it for its inode."""
    file = source.with_name(f"mutated{source.suffix}")
    file.unlink(missing_ok=True)
    file.write_bytes(content)
    return file
