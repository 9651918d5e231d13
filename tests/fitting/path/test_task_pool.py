"""Tasks side by side, started in whatever folder."""

import pytest

from ttus_opt.fitting.path.task_pool import task_pool


@pytest.mark.slow
def test_a_worker_executes_no_file_of_the_current_folder(tmp_path, monkeypatch):
    joblib = pytest.importorskip("joblib", reason="needs ttus-opt[parallel]")
    executor = pytest.importorskip("joblib.externals.loky").get_reusable_executor
    executor().shutdown(wait=True)  # workers of other tests began elsewhere
    for name in ("numpy", "joblib", "numba"):
        (tmp_path / f"{name}.py").write_text(f"open({name!r}, 'w').close()")
    monkeypatch.chdir(tmp_path)
    try:
        with task_pool(2, "") as run:
            assert sorted(run(joblib.delayed(abs)(-i) for i in range(3))) == [0, 1, 2]
    finally:
        executor().shutdown(wait=True)
    assert not [*tmp_path.glob("[!.]*[!y]")]
