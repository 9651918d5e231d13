"""A path that was stopped: another call ends with what one call would have found."""

import functools
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import (
    InputError,
    TtusWarning,
    presses,
    python,
    refuses,
    small_scene,
    some,
    torso,
)
from ttus_opt.fitting.path import path_file, path_solvers
from ttus_opt.fitting.path.path_dataset import PathRecord
from ttus_opt.fitting.path.path_file import inputs_of
from ttus_opt.fitting.path.weight_grid import WeightGrid

WEIGHTS = np.geomspace(1e-3, 10.0, 4)

#: Formulations whose points share a basis, start from each other, and are on their own
EVERY_KIND = ("eq10", "eq10_sign", "coulomb_global")


def scene():
    return small_scene("trilinear", shape=(6, 9, 6), n_poses=12)


def solve(file, name="eq10", jobs=1, dask="", **given):
    run = tt.PathRun(file, jobs, dask)
    asked = {"weights": {("force", "torque"): WEIGHTS}, **given}
    asked.setdefault("held_out", presses(torso(), 5, np.random.default_rng(3)))
    return tt.solution_path(name, asked.pop("scene", scene()), run=run, **asked)


@functools.cache
def kept():
    """The file of a whole path, to be taken up again."""
    with tempfile.TemporaryDirectory() as folder:
        solve(Path(folder, "path.nc"))
        return Path(folder, "path.nc").read_bytes()


@pytest.fixture
def solved(monkeypatch):
    """The points that were computed."""
    kept()
    seen = []
    plain = PathRecord.add

    def counted(self, at, solution, *more):
        plain(self, at, solution, *more)
        seen.append(at)

    monkeypatch.setattr(PathRecord, "add", counted)
    return seen


def stopped(monkeypatch, after, error):
    """Let an error end the path in the middle of a point."""
    plain, count = PathRecord._judge, 0

    def stops(self, *given):
        nonlocal count
        count += 1
        if count > after:
            raise error
        plain(self, *given)

    monkeypatch.setattr(PathRecord, "_judge", stops)
    return monkeypatch


def same(one, other, rtol):
    """All but times: how long it took, and when it was written."""
    assert set(one.variables) == set(other.variables)
    for name in set(one.variables) - {"seconds", "kkt_residual"}:
        a, b = one[name].to_numpy(), other[name].to_numpy()
        if a.dtype.kind == "f":
            scale = np.abs(np.nan_to_num(a)).max()
            np.testing.assert_allclose(a, b, rtol, rtol * scale, err_msg=str(name))
        else:
            np.testing.assert_array_equal(a, b, err_msg=str(name))
    passing = ("history", "inputs", "ttus_opt_kind", "ttus_opt_version")
    for name in one.attrs:
        if name not in passing:
            assert one.attrs[name] == other.attrs[name], name


@pytest.mark.parametrize("name", some(EVERY_KIND, 2))
def test_a_stopped_path_ends_like_one_that_was_not(name, tmp_path, monkeypatch, solved):
    more = {"extras": ["potential"]}
    if name == "eq10":
        more["extras"] = ["potential", "criteria"]
    whole, file = solve(None, name, **more), tmp_path / "path.nc"
    solved.clear()
    with monkeypatch.context() as patch:
        stopped(patch, 2, KeyboardInterrupt)
        with pytest.warns(
            TtusWarning, match=r"2 of 4 points .* goes on from .*path.nc"
        ):
            solve(file, name, **more)
    assert len(solved) == 2
    assert int((tt.read_solution_path(file)["status"] == 0).sum()) == 2
    found = solve(file, name, **more)
    assert len(solved) == len(set(solved)) == 4
    # a search fits every point alone, so that nothing depends on the order
    same(whole, found, 0.0 if name == "coulomb_global" else 2e-5)
    same(found, tt.read_solution_path(file), 0.0)
    again = solve(file, name, **more)
    assert len(solved) == 4
    same(found, again, 0.0)


def test_points_are_kept_while_the_path_goes_on(tmp_path, monkeypatch):
    """What a call that is killed leaves: no ``finally`` helps it."""
    file, seen = tmp_path / "path.nc", []
    plain = path_file.PathFile.save_now_and_then

    def look(self):
        plain(self)
        seen.append(tt.read_solution_path(file).attrs["points_done"])

    monkeypatch.setattr(path_file, "SAVE_EVERY", -1.0)
    monkeypatch.setattr(path_file.PathFile, "save_now_and_then", look)
    solve(file)
    assert seen == [1, 2, 3, 4]


@pytest.mark.parametrize(
    ("other", "told"),
    [
        ({"scene": small_scene("trilinear", shape=(6, 9, 6), n_poses=11)}, "scene"),
        ({"name": "eq10_sign"}, "formulation"),
        ({"laplace": 2.0}, "formulation"),
        ({"weights": {("force", "torque"): 2.0 * WEIGHTS}}, "weights"),
        ({"weights": {"force": WEIGHTS}}, "weights"),
        ({"held_out": ()}, "held-out recordings"),
        ({"solver": "clarabel"}, "solver"),
        ({"tolerance": 1e-5}, "tolerance"),
        ({"extras": ["potential"]}, "extras"),
    ],
)
def test_a_path_of_other_inputs_is_not_mixed_in(tmp_path, solved, other, told):
    file = tmp_path / "path.nc"
    given = dict(other)
    if "laplace" in given:  # a weight that the path does not vary
        declared = tt.load_formulation("eq10", scene()).with_weights(**given)
        given = {"name": declared, "scene": declared.scene}
    file.write_bytes(kept())
    with pytest.warns(TtusWarning, match=f"other [^:]*{told}.*: all points are"):
        found = solve(file, **given)
    assert len(solved) == 4
    same(found, tt.read_solution_path(file), 0.0)


def test_a_file_that_cannot_be_continued_is_named(tmp_path, solved):
    file = tmp_path / "path.nc"
    file.write_text("something else")
    with pytest.warns(TtusWarning, match="all points are computed.*path.nc"):
        found = solve(file)
    tt.write_solution_path(found.drop_attrs(deep=False), file)
    with pytest.warns(TtusWarning, match="path of unknown inputs"):
        solve(file)
    assert len(solved) == 8


@pytest.mark.slow
@pytest.mark.parametrize(("name", "rtol"), [("coulomb_global", 0.0), ("robust", 2e-5)])
def test_several_at_a_time_find_the_same(name, rtol, tmp_path):
    pytest.importorskip("joblib")
    weights = {"torque": WEIGHTS[:2]}
    one = solve(None, name, weights=weights)
    two = solve(tmp_path / "path.nc", name, weights=weights, jobs=2)
    same(one, two, rtol)


@pytest.mark.long
def test_a_dask_cluster_finds_the_same():
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        found = solve(None, "coulomb_global", dask=cluster.scheduler_address)
    same(solve(None, "coulomb_global"), found, 0.0)


def test_a_shared_basis_says_that_jobs_are_not_used():
    one = solve(None)
    with pytest.warns(TtusWarning, match="eq10 share their work: one process"):
        two = solve(None, jobs=2)
    same(one, two, 0.0)
    refuses(InputError, "jobs must be at least 1, got 0", solve, None, jobs=0)


def test_points_on_their_own_are_those_of_solvers_that_share_nothing():
    shares = {"eq10": False, "eq10_sign": False, "coulomb_global": True, "robust": True}
    for name, independent in shares.items():
        declared = tt.load_formulation(name, scene())
        point = path_solvers.point_solver(declared, "auto", path_solvers.Request())
        assert point.independent is independent, name


SCRIPT = """
from tests.fitting.path.test_path_file import checksums
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
    assert python("-c", SCRIPT).stdout.strip() == str(checksums("coulomb_global"))


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
