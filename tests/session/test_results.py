"""Which folders a session writes to, and what it removes there."""

import json

import pytest

from tests.kit import FileError, InputError, refuses
from tests.session.recordings import copied
from ttus_opt.session.results import SUMMARY, Results, complete_steps


def silent(name):
    pass


@pytest.fixture
def done(tmp_path):
    """Results of a session that came to its second step."""
    folder = tmp_path / "results"
    results = Results(folder, silent)
    results.check([])
    with results.step("surface"):
        results.path("surface.nc").parent.mkdir()
        results.path("surface.nc").touch()
        results.tell("surface", {"gap": float("nan")})
    with pytest.raises(InputError), results.step("clock"):
        raise InputError("no contact")
    return folder


def test_steps_that_are_complete_are_written_down(done):
    assert complete_steps(done) == ["surface"]
    assert json.loads((done / SUMMARY).read_text())["surface"] == {"gap": None}


def test_a_failed_step_says_what_is_complete(done):
    results = Results(done, silent)
    with results.step("surface"):
        pass
    with (
        pytest.raises(InputError, match=r"clock: no contact \(complete in .*: surface"),
        results.step("clock"),
    ):
        raise InputError("no contact")


def test_what_an_earlier_session_wrote_is_removed_and_nothing_else(done):
    (done / "notes.txt").touch()
    results = Results(done, silent)
    results.check([])
    assert (done / "surface.nc").is_file()
    results.path("field.nc")
    left = {file.name for file in done.iterdir()}
    assert left == {"notes.txt"}


def elsewhere(folder):
    (folder / "field.nc").touch()
    return folder


@pytest.mark.parametrize("filled", [elsewhere, copied])
def test_a_folder_of_other_work_is_refused(tmp_path, filled):
    """Another recording's description, too: it has the summary's name."""
    folder = filled(tmp_path)
    before = set(folder.iterdir())
    refuses(FileError, "holds unrelated files", Results(folder, silent).check, [])
    assert set(folder.iterdir()) == before


def test_the_recording_itself_is_refused(tmp_path):
    recording = copied(tmp_path)
    with pytest.raises(FileError, match="holds the recording"):
        Results(recording, silent).check([recording / SUMMARY])
