"""Mutations of sound command lines: the package's own errors and no others."""

import os

import numpy as np
import pytest

from tests.cli.conftest import PROBE
from ttus_opt.cli import main
from ttus_opt.core.errors import InputError
from ttus_opt.problem.formulation import load
from ttus_opt.solvers import registry
from ttus_opt.solvers.base import Request

SEED = 20261122

#: How many lines: a few each time, 300 with the slow tests, 10,000 with the long ones
LINES = [
    pytest.param(0, 4),
    pytest.param(10, 300, marks=pytest.mark.slow),
    *(
        pytest.param(i, 1000, marks=[pytest.mark.slow, pytest.mark.long])
        for i in range(10)
    ),
]

HOSTILE = [
    *("", " ", "-", "--", "=", ",", ":", "nan", "inf", "-inf", "1e308", "-1e308"),
    *("0", "-0", "-1", "1", "1.5", "1e-320", "1e9", "99999999999999999999", "true"),
    *("null", "[]", "{}", "abc", "Ünïcödé", "\x00", "a\nb", "%s", "$HOME", "*"),
    *(".", "..", "/", "/dev/null", "no/such/file.nc", "missing.csv", "x.py", "folder"),
    *("1,2,3", "1,2", "1e308,1,1", "a,b,c", "sphere:", "sphere:-1", "box:1,1"),
    *("sphere:1e308", "ellipsoid:0,0,0", "fit", "auto", "mm", "parsec", "xyzw"),
    *("--json", "--help", "--version", "--force", "--paper", "--nonsense"),
    *("--every", "--rate", "--shape", "--option", "--solver", "--formulation"),
    *("--inner", "--outer", "--r-inner", "--r-outer", "--tolerance", "--time-limit"),
    *("--torque-length", "--force-weight", "--sampling", "--columns", "--torque-about"),
    *("sectors=1.5", "torque_length=abc", "screening=1e200", "variation=nan", "=3"),
    *("screened", "viscous_drag", "total_variation", "coulomb_drag", "osqp", "scs"),
]


def far_enough(
    scene,
    formulation="eq10",
    *,
    solver="auto",
    tolerance=1e-6,
    time_limit=None,
    **options,
):
    """All of a fit but the solve, which no word can lead astray."""
    Request(tolerance, time_limit)
    program = load(formulation, scene, **options).compile()
    registry.candidates(solver, program)
    raise InputError("far enough")


def sound_lines(files, field):
    recording = ["--trajectory", str(files / "press.csv")]
    probe = ["--probe", PROBE, "--points", "60"]
    surface = ["--surface", str(files / "surface.nc")]
    small = ["--shape", "6,12,6", "--inner", "fit", "-o", "f.nc"]
    return [
        ["fit", *surface, *probe, *recording, *small],
        ["fit", *surface, *probe, *recording, *small, "--option", "ridge=1e-3"],
        ["evaluate", "--field", str(field), *probe, *recording, "--json"],
        ["render", "--field", str(field), *probe, *recording, "-o", "r.csv"],
        ["surface", str(files / "scan.npy"), "--no-support", "-o", "s.nc"],
        ["solvers"],
        ["formulations", "--json"],
    ]


def mutated(words, rng):
    """Words replaced, left out, doubled, put in, swapped or bent."""
    words = list(words)
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(1, len(words))) if len(words) > 1 else 0
        token = HOSTILE[int(rng.integers(len(HOSTILE)))]
        match int(rng.integers(6)):
            case 0 | 1:
                words[at] = token
            case 2:
                del words[at]
            case 3:
                words.insert(at, token)
            case 4:
                words.insert(at, words[at])
            case _:
                cut = int(rng.integers(len(words[at]) + 1))
                words[at] = words[at][:cut] + token + words[at][cut + 1 :]
        if not words:
            return ["--help"]
    return words


@pytest.mark.parametrize(("part", "n"), LINES)
@pytest.mark.filterwarnings("ignore::ttus_opt.core.errors.TtusWarning")
def test_mutated_lines(files, field, tmp_path, monkeypatch, capsysbinary, part, n):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    monkeypatch.setattr("ttus_opt.fitting.batch.fit", far_enough)
    rng, sound = np.random.default_rng([SEED, part]), sound_lines(files, field)
    for number in range(n):
        words = mutated(sound[int(rng.integers(len(sound)))], rng)
        told = f"seed {SEED}, part {part}, line {number}: {words}"
        try:
            main(words)
        except SystemExit as stop:
            assert stop.code in (0, 2, 130, None), told
        except BaseException as error:
            raise AssertionError(told) from error
        written = capsysbinary.readouterr()  # `-o -` writes files to stdout
        assert b"Traceback" not in written.err, told
        hidden = [name for name in os.listdir(tmp_path) if name.startswith(".")]
        assert not hidden, told
