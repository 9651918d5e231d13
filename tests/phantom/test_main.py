import numpy as np
from typer import Typer
from typer.testing import CliRunner

from ttus_opt.phantom.__main__ import main


def run(*arguments):
    app = Typer()
    app.command()(main)
    return CliRunner().invoke(app, list(arguments))


def test_a_stored_compliance_is_what_is_pressed(coarse_patch, tmp_path, monkeypatch):
    written = []

    def write(folder, patch, progress):
        written.append((folder, patch))

    monkeypatch.setattr("ttus_opt.phantom.__main__.write_example", write)
    monkeypatch.setattr("ttus_opt.phantom.example_data.COARSER", 6.0)
    folder = tmp_path / "made"
    folder.mkdir()
    stored = tmp_path / "skin.npz"
    coarse_patch.save(stored)
    result = run("--folder", str(folder), "--compliance", str(stored))
    assert result.exit_code == 0, result.output
    ((where, patch),) = written
    assert where == folder
    np.testing.assert_array_equal(patch.compliance, coarse_patch.compliance)
    with np.load(folder / "skin.npz") as skin:  # to press live
        n = len(skin["points"])
        assert 10 < n < len(coarse_patch.points)
        assert len(skin["compliance"]) == n * (n + 1) // 2


def test_a_bad_compliance_is_one_line_and_status_two(tmp_path):
    stored = tmp_path / "skin.npz"
    stored.write_bytes(b"no")
    result = run("--folder", str(tmp_path / "made"), "--compliance", str(stored))
    assert result.exit_code == 2
    assert result.stderr.startswith("error: ") and result.stderr.count("\n") == 1
    assert not (tmp_path / "made").exists()
