"""The reader in C gives the wrenches of `Renderer`, and refuses what is damaged."""

import ctypes
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.kit import (
    DRAG,
    InputError,
    built_c,
    ellipsoid,
    presses,
    pressing,
    small_scene,
    torso,
)
from ttus_opt.haptic.flat_file import write_flat
from ttus_opt.haptic.renderer import Renderer
from ttus_opt.voxmap.field import PotentialField
from ttus_opt.voxmap.voxmap import Voxmap

SOURCE = Path(__file__).parents[2] / "examples" / "c" / "ttus_reader.c"
REAL = ctypes.POINTER(ctypes.c_double)
OFF_GRID, BAD_POSE = -1, -2


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    flags = "-std=c99 -Wall -Wextra -O2"
    found = built_c(SOURCE, tmp_path_factory, *flags.split())
    found.ttus_load.restype = ctypes.c_void_p
    found.ttus_load.argtypes = [ctypes.c_char_p, ctypes.POINTER(ctypes.c_char_p)]
    found.ttus_render.argtypes = [ctypes.c_void_p, REAL, REAL, REAL]
    found.ttus_free.argtypes = [ctypes.c_void_p]
    return found


class Reader:
    """A field that C has read."""

    def __init__(self, library, path):
        self.library, error = library, ctypes.c_char_p()
        self.field = library.ttus_load(bytes(path), ctypes.byref(error))
        self.error = (error.value or b"").decode()

    def render(self, rotation, position):
        wrench = np.full(6, 7.0)
        arrays = [np.ascontiguousarray(a, float) for a in (rotation, position)]
        pointers = [a.ctypes.data_as(REAL) for a in (*arrays, wrench)]
        return self.library.ttus_render(self.field, *pointers), wrench

    def close(self):
        self.library.ttus_free(self.field)


@pytest.fixture
def read(library, tmp_path):
    """Write a field, have C read it, and free it at the end."""
    readers = []

    def reader(field, **limits):
        path = tmp_path / "field.flat"
        write_flat(path, field, ellipsoid(), **limits)
        readers.append(Reader(library, path))
        assert readers[-1].error == ""
        return readers[-1]

    yield reader
    for each in readers:
        each.close()


def random_field(sampling, n_theta=20, sector=None):
    """Values everywhere, in the layer of the skin too, where nothing may sample."""
    voxmap = Voxmap.from_surface(
        torso(), shape=(9, n_theta, 10), r_inner=0.03, sector=sector
    )
    values = np.random.default_rng(1).uniform(0.0, 3.0, voxmap.grid.shape)
    return PotentialField(voxmap, values, sampling)


FIELDS = {
    "voxel-mean": ("voxel-mean",),
    "trilinear": ("trilinear",),
    "size": ("contact-size:0.008",),
    "sector": ("trilinear", 21, (-0.5, 2.5)),
    "voxel-mean in a sector": ("voxel-mean", 21, (-0.5, 2.5)),
}


@pytest.mark.parametrize("name", FIELDS)
def test_fifty_poses(name, read):
    """Also above the chest's ends and beside a sector, where forces fade or end."""
    field = random_field(*FIELDS[name])
    reader, renderer = read(field), Renderer(field, ellipsoid())
    poses = presses(torso(), 50, np.random.default_rng(3), depth=0.025)
    position = poses.position.copy()
    position[40:, 2] = np.linspace(-0.01, 0.21, 10)
    forces, touched = [], 0
    for R, at in zip(poses.rotation, position, strict=True):
        expected, (count, wrench) = renderer.render(R, at), reader.render(R, at)
        assert count == (expected.contact_points if expected.in_grid else OFF_GRID)
        both = np.concatenate([expected.force, expected.torque])
        for part in (slice(3), slice(3, 6)):
            error = np.linalg.norm(wrench[part] - both[part])
            assert error <= 1e-9 * np.linalg.norm(both[part])
        forces.append(np.linalg.norm(expected.force))
        touched += count > 0
    assert touched > 25 and max(forces) > 0.5


def test_limits_are_the_renderers(read):
    field = random_field("trilinear")
    poses = presses(torso(), 9, np.random.default_rng(3))
    for limits in ({"force_limit": 0.01}, {"torque_limit": 1e-4}):
        reader, renderer = read(field, **limits), Renderer(field, ellipsoid(), **limits)
        acted = 0
        for R, at in zip(poses.rotation, poses.position, strict=True):
            expected = renderer.render(R, at)
            wrench = reader.render(R, at)[1]
            np.testing.assert_allclose(wrench[:3], expected.force, rtol=1e-9)
            np.testing.assert_allclose(wrench[3:], expected.torque, rtol=1e-9)
            acted += expected.saturated
        assert acted > 0


def test_poses(read):
    """Rounding is corrected, far is zero, and no rotation leaves the wrench alone."""
    field = random_field("trilinear")
    reader, renderer = read(field), Renderer(field, ellipsoid())
    at = presses(torso(), 1, np.random.default_rng(3)).position[0]
    rounded = Rotation.from_rotvec([0.3, 0.2, -1.0]).as_matrix().astype(np.float32)
    expected = renderer.render(rounded.astype(float), at).force
    np.testing.assert_allclose(reader.render(rounded, at)[1][:3], expected, rtol=1e-9)
    code, wrench = reader.render(np.eye(3), [0.0, 0.0, 7.0])
    assert code == OFF_GRID and not wrench.any()
    mirrored = np.diag([1.0, 1.0, -1.0])
    for bad in ((1.001 * np.eye(3), at), (mirrored, at), (np.eye(3), [np.nan, 0, 0])):
        code, wrench = reader.render(*bad)
        assert code == BAD_POSE and (wrench == 7.0).all()


def test_a_damaged_file(library, read, tmp_path):
    read(random_field("trilinear"))
    path = tmp_path / "field.flat"
    whole = path.read_bytes()
    wrong = bytearray(whole)
    wrong[len(whole) // 2] ^= 1
    counts = bytearray(whole)
    counts[15] = 0x80
    for content, error in (
        (wrong, "damaged: its checksum"),
        (whole + b"0", "damaged: its checksum"),
        (whole[:-9], "cut off"),
        (whole[:30], "cut off"),
        (counts, "damaged: its counts"),
        (b"CDF" + whole, "not a flat field"),
    ):
        path.write_bytes(content)
        reader = Reader(library, path)
        assert reader.field is None and error in reader.error
    assert "cannot open" in Reader(library, tmp_path / "none").error


def test_what_is_not_written(tmp_path):
    scene, path = small_scene("trilinear"), tmp_path / "field.flat"
    with pytest.raises(InputError, match="friction"):
        write_flat(path, pressing(scene, DRAG), scene.shell)
    with pytest.raises(InputError, match="force_limit must be positive"):
        write_flat(path, pressing(scene), scene.shell, force_limit=0.0)
    assert not path.exists()
