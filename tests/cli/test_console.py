"""One-line messages, JSON and the stage bar."""

import json
import sys
import time
import warnings

import numpy as np
import pytest
from tqdm import tqdm

from ttus_opt.cli import console
from ttus_opt.core.errors import TtusWarning


def test_json_holds_numbers_and_null(capsys):
    content = {
        "nan": float("nan"),
        "inf": np.float64("inf"),
        "count": np.int64(3),
        "rows": np.eye(2),
        "nested": {"x": (1, None)},
    }
    console.print_json(content)
    assert json.loads(capsys.readouterr().out) == {
        "nan": None,
        "inf": None,
        "count": 3,
        "rows": [[1.0, 0.0], [0.0, 1.0]],
        "nested": {"x": [1, None]},
    }


@pytest.mark.parametrize(
    ("message", "told"),
    [
        ("leave them out: pass drop_nan=True", "leave them out: pass --drop-nan"),
        ('choose another or solver="auto"', "choose another or --solver auto"),
        ("use surface='hull'", "use --probe-surface hull"),
        ("the unit is m", "the unit is m"),
        ("by box=-1,1e3,…; or", "by --box -1,1e3,…; or"),
        ("(box=… to take more)", "(--box … to take more)"),
        ("n_points must be 4", "--points must be 4"),
        ("a wrench_delay of 9 s", "a --wrench-delay of 9 s"),
        ("got 'wrench_delay' of n_points.csv", "got 'wrench_delay' of n_points.csv"),
        ("normalise q, or read it with repair=True", "normalise q"),
        ("give angles=3 or sign=2", "give angles=3 or sign=2"),  # no such options
    ],
)
def test_messages_are_told_as_options(monkeypatch, message, told):
    own = "drop_nan", "solver", "probe_surface", "unit", "box", "points", "wrench_delay"
    names = {name: f"--{name.replace('_', '-')}" for name in own}
    monkeypatch.setattr(console._words, "options", names)
    assert console.as_options(message) == told


def test_a_warning_is_one_line_and_told_once(capsys):
    with console.warnings_in_one_line():
        for _ in range(2):
            warnings.warn("two\n  lines", TtusWarning, stacklevel=1)
    assert capsys.readouterr().err == "warning: two lines\n"


def test_lines_are_no_wider_than_a_terminal(capsys, monkeypatch):
    """What a file or another program reads stays one line."""
    monkeypatch.setenv("COLUMNS", "20")
    for terminal in (False, True):
        monkeypatch.setattr(sys.stdout, "isatty", lambda shown=terminal: shown)
        console.tell({}, "force 0.136 N mean, 0.181 N rmse", "a table | is\nleft alone")
    whole, table = "force 0.136 N mean, 0.181 N rmse\n", "a table | is\nleft alone\n"
    narrow = "force 0.136 N mean,\n0.181 N rmse\n"
    assert capsys.readouterr().out == whole + table + narrow + table


def test_numpys_warnings_are_none_of_the_users(capsys):
    with console.warnings_in_one_line():
        warnings.simplefilter("default")
        warnings.warn("overflow in multiply", RuntimeWarning, stacklevel=1)
    assert capsys.readouterr().err == ""


def test_a_warning_has_a_line_of_its_own_beside_a_bar(capsys):
    with console.warnings_in_one_line(), tqdm(total=2, file=sys.stderr) as bar:
        bar.update()
        warnings.warn("off the grid", TtusWarning, stacklevel=1)
    shown = [line.rsplit("\r", 1)[-1] for line in capsys.readouterr().err.split("\n")]
    assert shown[0] == "warning: off the grid"
    assert "1/2" in shown[1]


def test_what_a_terminal_would_carry_out_is_not_printed():
    told = console.one_line("cannot read \x1b[2J\x00a.csv\udcff:\n no such  file")
    assert told == "cannot read \ufffd[2J\ufffda.csv\ufffd: no such file"


def shown_until(capsys, words):
    """What the bar's thread has written once it has written these words."""
    shown, until = "", time.monotonic() + 30.0
    while words not in shown and time.monotonic() < until:
        time.sleep(0.01)
        shown += capsys.readouterr().err
    return shown


def test_stages_are_shown_only_for_long_work(capsys, monkeypatch):
    with console.Stages(1) as begin:
        begin("quick work")
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(console, "PATIENCE", 0.02)
    pytest.importorskip("tqdm")  # which the bar would load during the first part
    with console.Stages(2) as begin:
        begin("first part")
        shown = shown_until(capsys, "first part")
        begin("second part")
    shown += capsys.readouterr().err
    assert "first part" in shown
    assert "2/2" in shown


def test_an_interrupt_as_a_bar_begins_leaves_none():
    """As the end of a command's time, which may come while its thread is started."""
    bar = console.Stages(1)
    begins = bar._thread.start

    def interrupted():
        begins()
        raise KeyboardInterrupt

    bar._thread.start = interrupted
    with pytest.raises(KeyboardInterrupt), console.speaking(0, quiet=False, json=False):
        bar.__enter__()
    assert not bar._thread.is_alive()


def test_a_failure_leaves_the_bar_where_it_was(capsys, monkeypatch):
    monkeypatch.setattr(console, "PATIENCE", 0.02)
    with pytest.raises(ValueError, match="broken"), console.Stages(3) as begin:
        begin("first part")
        shown = shown_until(capsys, "0/3")
        raise ValueError("broken")
    shown += capsys.readouterr().err
    assert "0/3" in shown
    assert "3/3" not in shown
