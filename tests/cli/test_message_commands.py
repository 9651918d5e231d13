"""``ttus-opt encode`` and ``decode``."""

import numpy as np
import pytest

from tests.cli.conftest import empty, refused
from ttus_opt.message import envelope
from ttus_opt.message.field_message import sampled
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.field import PotentialField

pytest.importorskip("pcodec", reason="needs ttus-opt[sensors]")


@pytest.fixture
def message(run, files, output):
    path = output / "surface.msg"
    assert run(f"encode {files / 'surface.nc'} -o {path}").status == 0
    return path


@pytest.mark.slow
def test_a_surface_and_its_field(run, files, field, output, message):
    told = run(
        f"encode {field} --base {message} --max-error 0.01 -o {output / 'f.msg'} --json"
    ).told
    assert told["holds"] == "field"
    assert told["bytes"] == (output / "f.msg").stat().st_size
    assert 0 < told["largest_error"] <= 0.01
    assert run(f"decode {message} -o {output / 's.nc'}").status == 0
    received = Surface.load(output / "s.nc")
    given = Surface.load(files / "surface.nc")
    assert np.abs(received.radius - given.radius).max() <= 0.25e-3
    answer = run(f"decode {output / 'f.msg'} --base {message} -o {output / 'f.nc'}")
    assert "field from" in answer.out
    before, after = PotentialField.load(field), PotentialField.load(output / "f.nc")
    read = sampled(after.voxmap)  # the surface was rounded after the fit
    assert np.abs(before.values - after.values)[read].max() <= 0.01 * (1 + 1e-6)


def test_what_changed(run, files, output, message):
    change = output / "change.msg"
    words = f"encode {files / 'surface.nc'} --base {message} -o {change}"
    assert "surface in" in run(words).out
    assert change.stat().st_size < message.stat().st_size
    told = run(f"decode {change} --base {message} -o {output / 's.nc'} --json").told
    assert told["holds"] == "surface"


@pytest.mark.slow
def test_what_is_refused(run, files, field, tmp_path, output):
    surface, to = files / "surface.nc", f"-o {output / 'x'}"
    refused(run(f"encode {field} {to}"), "give the surface's message as --base")
    refused(run(f"encode {surface} --max-error 0 {to}"), "--max-error")
    refused(run(f"encode {files / 'press.csv'} {to}"), "netCDF", "press.csv")
    refused(run(f"encode {tmp_path / 'no.nc'} {to}"), "not found")
    refused(run(f"encode {surface} -o {surface}"), "--force")
    refused(run(f"decode {surface} {to}"), f"{surface} is not a message of ttus_opt")
    (tmp_path / "empty.msg").touch()
    refused(run(f"decode {tmp_path / 'empty.msg'} {to}"), "empty")
    refused(run(f"decode {tmp_path} {to}"), "folder")
    assert empty(output)


def test_a_damaged_message_leaves_nothing(run, output, message):
    content = bytearray(message.read_bytes())
    content[40] ^= 1
    message.write_bytes(content)
    refused(run(f"decode {message} -o {output / 's.nc'}"), f"{message}: ", "checksum")
    assert [path.name for path in output.iterdir()] == ["surface.msg"]


def test_one_byte_after_the_longest_message_is_refused(
    run, output, message, monkeypatch
):
    monkeypatch.setattr(envelope, "LONGEST", len(message.read_bytes()))
    target = output / "surface.nc"
    assert run(f"decode {message} -o {target}").status == 0
    longer = output / "longer.msg"
    longer.write_bytes(message.read_bytes() + b"x")
    assert run(f"decode {longer} -o {output / 'none.nc'}").status == 2
    assert not (output / "none.nc").exists()
