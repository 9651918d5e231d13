"""``ttus-opt warm-up``: what it says of the folder; `test_warm_up` runs it."""

import json
from pathlib import Path

import pytest

from ttus_opt.cli import warm_up
from ttus_opt.core import cache_folder


@pytest.mark.parametrize("folder", [None, Path("somewhere")])
def test_it_says_where_the_code_is_kept(run, folder, monkeypatch):
    monkeypatch.setattr(warm_up, "warm_up", lambda _: 12.0)
    monkeypatch.setattr(cache_folder, "cache_folder", lambda: folder)
    where = "not kept" if folder is None else "kept in somewhere"
    assert run("warm-up").out.strip().endswith(f"compiled in 12 s, {where}")
    told = json.loads(run("warm-up --json").out)
    assert told == {"seconds": 12.0, "folder": folder and "somewhere"}
