"""Mutated messages: the package's own errors and no others, bounded memory."""

import resource

import numpy as np
import pytest

from tests.hostile import SEED, mutated
from tests.kit import TtusError, torso
from tests.message.patients import dented, sent, sent_sector, uneven
from tests.message.sealing import body, sealed
from ttus_opt.message import decode, encode
from ttus_opt.message.envelope import NAMES

pytest.importorskip("pcodec", reason="needs ttus-opt[sensors]")

#: Part and number of mutations: a few each time, 100,000 with the long tests
NUMBERS = [
    pytest.param(0, 150),
    pytest.param(1, 4_000, marks=pytest.mark.slow),
    *(
        pytest.param(i, 10_000, marks=[pytest.mark.slow, pytest.mark.long])
        for i in range(2, 12)
    ),
]

#: What all of it may take beside what the test had before [KiB]
MEMORY = 400 * 1024


def sound():
    whole = encode(uneven())
    small = encode(torso(8, 6))
    surface, field = sent()
    same, sector = sent_sector()
    return [
        (whole, None),
        (small, None),
        (encode(dented(uneven()), base=whole), whole),
        (field, surface),
        (sector, same),
    ]


def hostile(n, part):
    """Mutated messages; three in four with the envelope put right again."""
    rng, messages = np.random.default_rng([SEED, part]), sound()
    for number in range(n):
        message, base = messages[int(rng.integers(len(messages)))]
        if rng.random() < 0.25:
            yield number, mutated(message, rng), base
            continue
        kind = message[5] if rng.random() < 0.98 else int(rng.integers(256))
        if kind not in NAMES:
            base = None
        yield number, sealed(mutated(body(message), rng), kind), base


@pytest.mark.parametrize(("part", "n"), NUMBERS)
@pytest.mark.filterwarnings("ignore::ttus_opt.core.errors.TtusWarning")
def test_mutated_messages(part, n):
    messages = hostile(n, part)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    refused = 0
    for number, message, base in messages:
        try:
            decode(message, base=base, max_voxels=20_000)
        except TtusError as error:
            refused += 1
            assert "\n" not in str(error)
        except BaseException as error:  # a panic of Rust is no Exception
            told = f"seed {SEED}, part {part}, message {number}: {message!r}"
            raise AssertionError(told) from error
    assert refused > 0.8 * n
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < before + MEMORY
