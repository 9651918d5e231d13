"""What all pictures share: their files, and that nothing global is touched."""

import matplotlib
import numpy as np
import pytest

from tests.report.plots.drawn import half_seen
from ttus_opt.core.errors import FileError, InputError
from ttus_opt.report import plots
from ttus_opt.report.plots import canvas

#: How files of each kind begin
BEGIN = {".png": b"\x89PNG", ".pdf": b"%PDF", ".svg": b"<?xml"}


def drawn():
    with canvas.look():
        figure = canvas.new_figure(3.0, 2.0)
        axes = figure.add_subplot()
        axes.plot([0.0, 1.0], [0.0, 2.0])
        axes.set_xlabel("time [s]")
    return figure


@pytest.mark.parametrize("suffix", canvas.SUFFIXES)
def test_a_picture_is_a_small_file_of_its_kind(suffix, tmp_path):
    file = tmp_path / f"picture{suffix}"
    canvas.save_picture(drawn(), file)
    content = file.read_bytes()
    assert content.startswith(BEGIN[suffix])
    assert 1_000 < len(content) < 200_000
    assert list(tmp_path.iterdir()) == [file]
    assert b"CreationDate" not in content and b"dc:date" not in content
    canvas.save_picture(drawn(), file)
    assert file.read_bytes() == content


def test_labels_lie_within_the_picture(tmp_path):
    figure = drawn()
    canvas.save_picture(figure, tmp_path / "picture.png")
    (axes,) = figure.axes
    label = axes.xaxis.label.get_window_extent()
    width, height = figure.get_size_inches() * figure.dpi
    assert label.x0 >= 0 and label.y0 >= 0
    assert label.x1 <= width and label.y1 <= height


def test_the_look_is_of_these_pictures_alone():
    before = dict(matplotlib.rcParams)
    figure = drawn()
    assert dict(matplotlib.rcParams) == before
    assert not figure.axes[0].spines["top"].get_visible()


def test_a_picture_needs_a_known_suffix_and_a_folder(tmp_path):
    with pytest.raises(InputError, match=r"picture.jpg: the name must end in .png"):
        canvas.save_picture(drawn(), tmp_path / "picture.jpg")
    canvas.require_picture_suffix("PICTURE.PNG")
    (tmp_path / "file").touch()
    with pytest.raises(FileError, match="cannot write"):
        canvas.save_picture(drawn(), tmp_path / "file" / "picture.png")


@pytest.mark.parametrize(
    "draw",
    [
        lambda fields, series: plots.force_over_time(series, "presses"),
        lambda fields, series: plots.residual_histogram(
            *([e] for e in series.values())
        ),
        lambda fields, series: plots.overview(fields[1], np.zeros((1, 3)), series),
        lambda fields, series: plots.surface_picture(half_seen()),
        pytest.param(
            lambda fields, series: plots.potential_slices(*fields),
            marks=pytest.mark.slow,
        ),
    ],
    ids=["forces", "residuals", "overview", "surface", "potential"],
)
def test_margins_hold_what_stands_in_them(draw, fields, evaluations):
    figure = draw(fields, evaluations)
    with canvas.look():  # ticks are made when they are drawn
        drawn = figure.get_tightbbox()
    width, height = figure.get_size_inches()
    assert drawn.x0 >= 0.0 and drawn.y0 >= 0.0
    assert drawn.x1 <= width and drawn.y1 <= height
