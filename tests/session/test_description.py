"""What a description may say, and the one line on what it may not."""

import numpy as np
import pytest

from tests.hostile import only_our_errors
from tests.kit import FileError, TtusError, refuses
from tests.session.recordings import changed, described
from ttus_opt.session.description import read_description


def test_the_example_is_understood(recording):
    found = read_description(recording)
    assert found.title == "Synthetic recording"
    assert found.fitted == ["press_fit", "sweep_fit"]
    assert found.fit.shape == (12, 24, 12)
    assert found.clock.by == "gravity"
    assert found.force.sensor is not None
    assert len(found.scan.cameras) == 2
    np.testing.assert_allclose(found.tracker.probe_to_target[3], [0, 0, 0, 1])
    # the same by its file, and as YAML
    assert read_description(recording / "session.json").title == found.title
    yaml = pytest.importorskip("yaml", reason="needs ttus-opt[sensors]")
    content = described(recording)
    (recording / "session.json").unlink()
    (recording / "session.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    assert read_description(recording).recordings == found.recordings


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("trackr", {}, "trackr is not known: did you mean tracker?"),
        ("tracker.paint", 1, "tracker.paint is not known: choose from file"),
        ("tracker.file", "no.csv", "tracker.file is no.csv, which is not in"),
        ("tracker.file", None, "tracker.file is missing: add it"),
        ("tracker.frame", "robot", "must be tracker or scan or patient, got 'robot'"),
        ("tracker.frame", "scan", "tracker.tags is for frame tracker"),
        ("tracker.tags", None, "to_scan or tags must be given"),
        ("tracker.to_scan", [0, 0, 0, 0, 0, 0, 1], "to_scan or tags must be given"),
        ("tracker.probe_to_target", [1, 2, 3], "probe_to_target is not a rigid motion"),
        ("tracker.probe_to_target", "no.json", "probe_to_target|no.json"),
        ("tracker.columns", {"quaternion": ["a", "b", "c", "d"]}, "never guessed"),
        ("force.frame", "probe", "is for contact wrenches"),
        ("force.down_frame", "moon", "must be tracker or scan or patient"),
        ("force.down", [0, 1], "must be a list of 3 numbers"),
        ("force.sensor.sign", "both", "sign must be one of on-probe, by-probe"),
        ("force.sensor.axes", [0, 0, 0, 2], "force.sensor cannot be used"),
        ("force.sensor", None, "frame is missing"),
        ("free", None, "both the stretch in free air"),
        ("free.to", -1, "free.to must be after from"),
        ("free.use", "fit", "free.use is not known"),
        ("clock.by", "ear", "must be gravity or contact or offset"),
        ("clock.by", "contact", "gravity tells the offset of raw readings"),
        ("clock.offset", 0.3, "go together"),
        ("clock.largest_gap", "wide", "must be a finite number"),
        ("recordings.press_fit.use", "look", "must be fit or test"),
        ("recordings.press_fit.from", True, "must be a finite number"),
        ("recordings", {}, "has no stretch with use: fit"),
        ("recordings.../evil", {"from": 0, "to": 1, "use": "fit"}, "names a file"),
        ("fit.shape", [4, 5.5, 6], "must be whole numbers"),
        ("fit.options", {"force_weight": "much"}, "must be a finite number"),
        ("fit.formulation", "magic", "fit.formulation cannot be used: .*magic"),
        ("scan.intrinsics", 5, "must be a file or a list of files"),
        ("scan.axis_from", "no.csv", "scan.axis_from is no.csv, which is not in"),
        ("probe", "probe.stl", "probe is probe.stl, which is not in"),
    ],
)
def test_what_it_may_not_say(recording, key, value, words):
    if key == "recordings.../evil":
        content = described(recording)["recordings"]
        changed(recording, "recordings", {**content, "../evil": value})
    else:
        changed(recording, key, value)
    refuses(TtusError, words, read_description, recording)


def test_no_description(tmp_path):
    refuses(FileError, "not found", read_description, tmp_path / "nowhere")
    refuses(FileError, r"has no session\.yaml", read_description, tmp_path)
    (tmp_path / "session.json").write_text("[1]")
    refuses(FileError, "must map names", read_description, tmp_path)
    (tmp_path / "session.json").write_text('{"a": ')
    refuses(FileError, r"JSON \(line 1\)", read_description, tmp_path)


def test_weights_as_yaml_writes_them(recording):
    """YAML 1.1 reads 1e-2 as a text."""
    pytest.importorskip("yaml", reason="needs ttus-opt[sensors]")
    changed(recording, "fit.options", {"force_weight": "1e-2"})
    assert read_description(recording).fit.options == {"force_weight": 0.01}


@pytest.mark.parametrize("n", [60, pytest.param(3000, marks=pytest.mark.slow)])
def test_mutations(recording, n):
    source = recording / "session.json"
    only_our_errors([source], read_description, n)


@pytest.mark.parametrize("key", ["formulation", "solver"])
def test_a_description_names_no_code(recording, key):
    """It is not even looked at, unless its reader trusts it."""
    (recording / "mine.py").write_text("raise RuntimeError('executed')")
    changed(recording, f"fit.{key}", "mine.py")
    with pytest.raises(FileError, match=rf"fit\.{key} names the code 'mine.py'"):
        read_description(recording)
    if key == "formulation":
        changed(recording, "fit.options", {"force_weight": 1.0})
    try:
        plan = read_description(recording, trust=True).fit
    except FileError as error:
        assert "executed" in str(error)  # its options are asked for
    else:
        assert plan.solver == "mine.py"
