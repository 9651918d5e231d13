"""Checksums of a path's inputs: alike for alike inputs, in every process."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.conftest import small_scene
from ttus_opt.fitting.path.path_file import inputs_of
from ttus_opt.fitting.path.weight_grid import WeightGrid

SCRIPT = """
from tests.fitting.path.test_path_file_inputs import checksums
print(checksums("coulomb_global"))
"""


def checksums(given, scene=None, **options):
    solver = options.pop("solver", "auto")
    scene = scene or small_scene("trilinear", shape=(6, 9, 6), n_poses=6)
    declared = tt.load_formulation(given, scene, **options)
    grid = WeightGrid.of({"torque": [0.1, 1.0]}, ["torque"])
    return inputs_of(declared, grid, {}, solver, 1e-6, [])


@pytest.mark.slow
def test_another_process_finds_the_same():
    found = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True
    )
    assert found.stdout.strip() == str(checksums("coulomb_global"))


def test_last_digits_of_computed_numbers_do_not_count():
    """They differ with the number of threads; a change of data is larger."""
    scene = small_scene("trilinear", shape=(6, 9, 6), n_poses=6)
    plain = checksums("eq10", scene)
    noise = 1.0 + 1e-14 * np.random.default_rng(0).normal(size=scene.b.shape)
    assert checksums("eq10", replace(scene, b=scene.b * noise)) == plain
    for scale in (1.001, 2.0):  # of all entries, too
        other = checksums("eq10", replace(scene, b=scale * scene.b))
        assert {k for k in plain if plain[k] != other[k]} == {"scene", "formulation"}


def test_a_penalty_and_a_searched_range_count():
    assert checksums("robust") == checksums("robust")
    robust, finer = checksums("robust"), checksums("robust", limit=0.6)
    assert {k for k in robust if robust[k] != finer[k]} == {"formulation"}
    scene = small_scene("trilinear", shape=(6, 9, 6), n_poses=6)
    declared = tt.load_formulation("coulomb_global", scene)
    narrow = declared.with_search(replace(declared.search, high=0.5))
    neutral = declared.with_search(replace(declared.search, neutral=0.1))
    found = [
        checksums(one, scene)["formulation"] for one in (declared, narrow, neutral)
    ]
    assert len(set(found)) == 3


def test_the_text_of_a_solver_counts(tmp_path):
    file = tmp_path / "own.py"
    found = []
    for text in ("SOLVERS = ()", "SOLVERS = []"):
        file.write_text(text)
        found.append(checksums("eq10", solver=file)["solver"])
    found.append(checksums("eq10", solver="structured")["solver"])
    assert len(set(found)) == 3
