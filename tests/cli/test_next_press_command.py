"""``ttus-opt next-press``: what it tells, writes and refuses."""

import pytest

import ttus_opt as tt
from tests.cli.conftest import scene_words


def words(files, more=""):
    return f"next-press {scene_words(files, '8,12,6', 100)} --spacing 0.06 {more}"


@pytest.mark.slow
def test_it_names_places_and_writes_them(run, files, output):
    poses, picture = output / "next.csv", output / "next.png"
    told = run(words(files, f"--count 2 --json -o {poses} --picture {picture}")).told
    assert len(told["presses"]) == 2 and told["model"]
    assert told["region_std_after_N"] < told["region_std_before_N"]
    read = tt.read_trajectory(poses)
    assert read.position.tolist() == [p["position_m"] for p in told["presses"]]
    assert picture.stat().st_size > 10_000
    eq10 = "--formulation eq10 --option force_weight=0.1"
    plain = run(words(files, f"--count 2 --angles 90,200 {eq10}"))
    *table, last = plain.out.splitlines()
    assert last.startswith("a press of") and max(map(len, table)) <= 80
    assert [line[0] for line in table if line[0] != " "] == ["1", "2"]
