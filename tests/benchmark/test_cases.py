"""Cases: what they are made of, and that they survive the way to another process."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ttus_opt.benchmark import memory
from ttus_opt.benchmark.cases import (
    CaseSpec,
    existing,
    reference_cases,
    with_new_values,
)
from ttus_opt.benchmark.machine import describe
from ttus_opt.benchmark.row import RunSpec
from ttus_opt.errors import FileError, InputError


def test_reference_cases_have_the_sizes_of_the_design() -> None:
    sizes = {case.name: (case.n_voxels, case.n_poses) for case in reference_cases()}
    assert sizes == {"S": (51_840, 200), "M": (345_600, 400), "L": (1_080_000, 400)}


def test_one_reference_case_by_name() -> None:
    assert [case.name for case in reference_cases("M")] == ["M"]
    with pytest.raises(InputError, match="unknown case 'XL'"):
        reference_cases("XL")


def test_sampled_otherwise_a_case_has_another_name_and_inner_value() -> None:
    case = reference_cases("S")[0]
    assert case.sampled("trilinear") == case
    other = case.sampled("voxel-mean")
    assert other.name == "S-voxel-mean" and other.inner == "fit"
    assert other.small().build().sampling == "voxel-mean"


def test_case_and_run_survive_json() -> None:
    case = reference_cases("S")[0]
    spec = RunSpec(case, "eq10", "osqp", {"force_weight": 1e-2}, repeat=3)
    told = json.loads(json.dumps(spec.as_dict()))
    again = RunSpec.from_dict(told)
    assert again == spec
    assert again.key == spec.key
    assert CaseSpec.from_dict(told["case"]) == case


def test_key_tells_questions_apart() -> None:
    spec = RunSpec(reference_cases("S")[0], "folder/mine.py", "osqp")
    assert spec.label == "mine"
    for other in (
        replace(spec, tolerance=1e-8),
        replace(spec, options={"force_weight": 1.0}),
        replace(spec, case=replace(spec.case, n_poses=3)),
    ):
        assert other.key != spec.key


def test_small_case_touches_and_new_values_change_values_only() -> None:
    scene = replace(reference_cases("S")[0].small(), n_poses=24).build()
    assert len(scene.trajectory) == 24
    assert (scene.rows.contact_points > 0).any()
    other = with_new_values(scene, seed=1)
    assert other.N is scene.N
    assert other.L is scene.L
    assert 0.0 < np.linalg.norm(other.f - scene.f) < 0.2 * np.linalg.norm(scene.f)
    again = with_new_values(scene, seed=1)
    np.testing.assert_array_equal(other.tau, again.tau)


WARM_UP_PROGRAM = """
import gc
import numpy as np
from numba.core.dispatcher import Dispatcher
from ttus_opt.benchmark.cases import reference_cases
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.voxmap import Voxmap

def ready():
    return {
        f"{each.py_func.__module__}.{each.py_func.__name__} {signature}"
        for each in gc.get_objects() if isinstance(each, Dispatcher)
        for signature in each.signatures
    }

def solve(case):
    surface = Surface.load(case.surface)
    voxmap = Voxmap.from_surface(surface, shape=case.shape, r_inner=case.r_inner)
    laplace = LaplaceSystem.assemble(voxmap)
    laplace.solve(laplace.solve_adjoint(np.ones(case.n_voxels)))

(case,) = reference_cases("S")
solve(case.small())
before = ready()
solve(case)
print(len(before), *sorted(ready() - before), sep="\\n")
"""


def test_small_case_compiles_all_that_a_case_calls() -> None:
    # in a process of its own: in this one other tests have compiled much already
    told = subprocess.run(
        [sys.executable, "-c", WARM_UP_PROGRAM],
        capture_output=True,
        text=True,
        check=True,
    )
    count, *late = told.stdout.split("\n")[:-1]
    assert int(count) > 5
    assert not late


def test_existing_makes_paths_absolute(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("s.nc", "a.csv"):
        Path(name).write_text("x")
    case = CaseSpec("user", "s.nc", "sphere:0.02", ("a.csv",), (4, 6, 4))
    found = existing(case)
    assert found.surface == str(tmp_path / "s.nc")
    assert found.trajectories == (str(tmp_path / "a.csv"),)
    assert found.probe == "sphere:0.02"
    with pytest.raises(FileError, match=r"probe file not found.*probe\.stl"):
        existing(replace(case, probe="probe.stl"))


MEMORY_PROGRAM = """
import numpy as np
from ttus_opt.benchmark import memory
memory.reset_peak()
before = memory.peak_bytes()
block = np.ones(16 * 2**20)
during = memory.peak_bytes()
del block
memory.reset_peak()
print(before, during, memory.peak_bytes())
"""


def test_peak_memory_sees_an_allocation_and_forgets_it() -> None:
    if memory._from_status("VmHWM") is None:
        pytest.skip("this system does not tell a process's peak")
    # in a process of its own: this one has freed pages that an array would take again
    told = subprocess.run(
        [sys.executable, "-c", MEMORY_PROGRAM],
        capture_output=True,
        text=True,
        check=True,
    )
    before, during, after = map(int, told.stdout.split())
    assert during - before >= 0.9 * 128 * 2**20
    assert after < during - 64 * 2**20


def test_machine_names_what_decides_a_figure() -> None:
    facts = describe()
    assert int(facts["cores"]) >= 1
    assert facts["numpy"] == np.__version__
