"""Pictures drawn by another process, and by this one where it cannot."""

from __future__ import annotations

from pathlib import Path

import pytest
from matplotlib.figure import Figure

from ttus_opt.errors import FileError
from ttus_opt.report import drawing_beside
from ttus_opt.report.drawing_beside import DrawingBeside, Picture


def pictures(folder: Path) -> list[Picture]:
    return [Picture(folder / f"{n}.png", Figure, ((n, 1.0),)) for n in (1, 2)]


@pytest.mark.parametrize("cores", [1, 2])
def test_all_are_drawn(
    cores: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(drawing_beside, "cores", lambda: cores)
    here, there = pictures(tmp_path)
    drawn = []
    monkeypatch.setattr(Picture, "save", lambda one: drawn.append(one.path))
    with DrawingBeside() as beside:
        beside.save([here], [there])
    assert drawn == [here.path, there.path][: 3 - cores]
    assert there.path.exists() is (cores == 2)


def test_what_the_other_cannot_draw_is_told_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(drawing_beside, "cores", lambda: 2)
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    with DrawingBeside() as beside, pytest.raises(FileError, match="file"):
        beside.save([], pictures(blocked))


def test_an_error_meanwhile_ends_the_other_process(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(drawing_beside, "cores", lambda: 2)
    with pytest.raises(KeyError), DrawingBeside() as beside:
        raise KeyError("no solution")
    assert beside._process is not None
    assert beside._process.returncode is not None
