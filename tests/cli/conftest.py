"""What every command's test needs: a way to run it and a small torso's files."""

import json
import re
import shlex
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from tests.kit import presses, torso
from ttus_opt.cli import main

#: A bar as the console draws it; what follows may stand on its line
BAR = re.compile(r"[^\r\n|]*\|[^\r\n|]*\|\s*\d+/\d+\s+[\d:]+")

PROBE = "ellipsoid:0.02,0.015,0.015"


@dataclass(frozen=True)
class Answer:
    status: int
    out: str
    err: str

    @property
    def errors(self):
        """Lines on stderr without progress bars, which a slow machine shows."""
        lines = BAR.sub("", self.err).splitlines()
        return [line.strip() for line in lines if line.strip()]

    @property
    def told(self):
        """What ``--json`` says, of a command that ended well."""
        assert self.status == 0, self.err
        return json.loads(self.out)


Run = Callable[[str], Answer]


@pytest.fixture
def run(capsys, monkeypatch):
    """Runs ``ttus-opt <words>`` in this process, in 80 columns."""
    monkeypatch.setenv("COLUMNS", "80")

    def call(words):
        with pytest.raises(SystemExit) as stop:
            main(shlex.split(words))
        told = capsys.readouterr()
        return Answer(int(stop.value.code or 0), told.out, told.err)

    return call


@pytest.fixture(scope="session")
def files(tmp_path_factory):
    """A small torso's surface, its scan and a recording of presses."""
    folder = tmp_path_factory.mktemp("files")
    surface = torso()
    surface.save(folder / "surface.nc")
    rng = np.random.default_rng(0)
    presses(surface, 30, rng).save(folder / "press.csv")
    theta, z = rng.uniform(0, 2 * np.pi, 6000), rng.uniform(0, 0.2, 6000)
    r = surface.radius_at(theta, z) + rng.normal(0, 5e-4, theta.shape)
    np.save(
        folder / "scan.npy", np.stack([r * np.cos(theta), r * np.sin(theta), z], axis=1)
    )
    return folder


def scene_words(files, shape="10,16,8", n_points=200):
    """The torso's files and a coarse grid, as every command on a scene takes them."""
    return (
        f"--surface {files / 'surface.nc'} --probe {PROBE} --points {n_points} "
        f"--trajectory {files / 'press.csv'} --shape {shape}"
    )


def judged(files):
    """Probe and recording by which a field is judged, those of `fit_words`."""
    return f"--probe {PROBE} --points 300 --trajectory {files / 'press.csv'}"


def fit_words(files, output, more=""):
    own = scene_words(files, "16,24,12", 300)
    return f"fit {own} --inner fit --sampling trilinear -o {output} {more}"


@pytest.fixture(scope="session")
def field(files):
    """A field file, fitted by the command itself."""
    with pytest.raises(SystemExit) as stop:
        main(shlex.split(fit_words(files, files / "field.nc")))
    assert not stop.value.code
    return files / "field.nc"


def refused(answer, *words):
    """One line ``error: …`` with these words, status 2, nothing on stdout."""
    assert answer.status == 2
    assert answer.out == ""
    assert len(answer.errors) == 1, answer.err
    line = answer.errors[0]
    assert line.startswith("error: ")
    for word in words:
        assert word in line


def empty(folder):
    return not list(folder.iterdir())


@pytest.fixture
def output(tmp_path):
    (tmp_path / "output").mkdir()
    return tmp_path / "output"
