"""What many tests need: errors, refusals, a torso, a probe, presses, scenes."""

import ctypes
import functools
import os
import shutil
import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ttus_opt.contact.friction import Sliding
from ttus_opt.contact.scene import Scene
from ttus_opt.core.errors import (  # noqa: F401
    FileError,
    GeometryError,
    InputError,
    MissingPackageError,
    MistakeWarning,
    NumericalError,
    SolverUnavailableError,
    TtusError,
    TtusWarning,
)
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.problem.terms.drag import GlobalCoulomb
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.field import PotentialField
from ttus_opt.voxmap.voxmap import Voxmap

SHARED = Path(__file__).resolve().parents[1].parent / "shared" / "data"


def shared_data(name=""):
    """A file or folder of the real and independent data, or a skip."""
    path = SHARED / name
    if not path.exists():
        pytest.skip(f"real data not here: {path}")
    return path


def refuses(error, words, call, /, *given, **options):
    """The call raises this error; returns its message.

    Args:
        error: Class of the error.
        words: Pattern that its message holds; "" for any.
        call: What is refused.
        given: Its arguments.
        options: Its named ones.
    """
    with pytest.raises(error, match=words or None) as told:
        call(*given, **options)
    message = str(told.value)
    assert "\n" not in message, "a message is one line"
    return message


def python(*words, status=0, timeout=300.0, cwd=None, **environment):
    """Run Python in a process of its own, with these words; what it said.

    Args:
        words: As on its command line.
        status: With which it has to end.
        timeout: After which it is ended [s].
        cwd: Where it runs; here by default.
        environment: Beside what is set.
    """
    done = subprocess.run(
        [sys.executable, *map(str, words)],
        capture_output=True,
        text=True,
        timeout=timeout,
        cwd=cwd,
        env={**os.environ, **environment},
        check=False,
    )
    assert done.returncode == status, done.stderr
    return done


def started(*words, cwd=None):
    """A process of Python with these words, in a session."""
    return subprocess.Popen(
        [sys.executable, *map(str, words)],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def own_port():
    """A free port of this machine that the system gives to nobody who asks for any."""
    return next(filter(is_free, range(20_000 + os.getpid() % 10_000, 32_000)))


def is_free(port):
    """Whether a port of this machine is free for streams and datagrams."""
    for kind in (socket.SOCK_STREAM, socket.SOCK_DGRAM):
        with socket.socket(socket.AF_INET, kind) as one:
            try:
                one.bind(("127.0.0.1", port))
            except OSError:
                return False
    return True


def some(values, quick):
    """Values for a test: all of them, slow but for the first few."""
    return [
        pytest.param(value, marks=pytest.mark.slow if i >= quick else ())
        for i, value in enumerate(values)
    ]


@functools.cache
def torso(n_theta=90, n_z=31):
    """An elliptical torso of 0.12 × 0.09 m half axes, waisted, 0.2 m long."""
    theta = np.arange(n_theta)[:, None] * 2 * np.pi / n_theta
    z = np.linspace(0.0, 0.2, n_z)
    waist = 1.0 - 0.08 * np.sin(np.pi * z / 0.2)
    radius = waist / np.sqrt((np.cos(theta) / 0.12) ** 2 + (np.sin(theta) / 0.09) ** 2)
    return Surface.from_radius(radius, z)


@functools.cache
def ellipsoid(n_points=300, semi_axes=(0.02, 0.015, 0.015)):
    """A probe; the same one for whoever asks for the same."""
    return PointShell.ellipsoid(semi_axes=semi_axes, n_points=n_points)


def presses(surface, n_poses, rng, depth=0.008):
    """Random presses around the front of a surface, with made-up wrenches."""
    angle = rng.uniform(0.3, 2.8, n_poses)
    z = rng.uniform(0.06, 0.14, n_poses)
    r = surface.radius_at(angle, z) + 0.012 - rng.uniform(0.0, depth, n_poses)
    position = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    rotation = Rotation.from_rotvec(rng.normal(0.0, 0.4, (n_poses, 3))).as_matrix()
    outward = position / np.linalg.norm(position, axis=1, keepdims=True)
    force = outward * rng.uniform(0.5, 6.0, (n_poses, 1))
    return Trajectory(
        np.arange(n_poses) * 0.05,
        position,
        rotation,
        force + rng.normal(0.0, 0.3, force.shape),
        rng.normal(0.0, 0.02, force.shape),
    )


def with_wrenches(scene, force, torque=None):
    """The scene with other forces [N] and torques [N·m], of frames or in one row."""
    given = scene.trajectory
    other = given.torque if torque is None else torque.reshape(-1, 3)
    measured = replace(given, force=force.reshape(-1, 3), torque=other)
    return replace(scene, trajectory=measured)


@functools.cache
def three_presses():
    """Frames in contact with one in the air after every four."""
    scene = small_scene("trilinear", n_poses=15)
    position = scene.trajectory.position.copy()
    position[4::5, :2] *= 1.2
    trajectory = replace(scene.trajectory, position=position)
    return Scene.assemble(
        scene.voxmap, scene.shell, trajectory, inner=2.0, sampling="trilinear"
    )


@functools.cache
def small_scene(sampling="voxel-mean", shape=(9, 20, 10), n_poses=12, seed=0):
    """A scene of a couple of thousand voxels, for brute force."""
    rng = np.random.default_rng(seed)
    surface = torso()
    return Scene.assemble(
        Voxmap.from_surface(surface, shape=shape, r_inner=0.03),
        ellipsoid(),
        presses(surface, n_poses, rng),
        inner=2.0,
        outer=1.5,
        sampling=sampling,
    )


@functools.cache
def dragged_scene(acts_at, mu=0.3, viscous=0.0, shape=(12, 30, 14), n=60):
    """Wrenches made from the Laplace field and drag, without noise."""
    surface = torso()
    rng = np.random.default_rng(3)
    angle = 1.4 + 0.5 * np.sin(0.3 * np.arange(n))
    z = 0.1 + 0.03 * np.cos(0.21 * np.arange(n))
    r = surface.radius_at(angle, z) + 0.007 + 0.002 * np.sin(0.5 * np.arange(n))
    position = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    tilt = Rotation.from_rotvec(0.1 * np.cumsum(rng.normal(0, 0.2, (n, 3)), axis=0))
    bare = Trajectory(0.05 * np.arange(n), position, tilt.as_matrix())
    voxmap = Voxmap.from_surface(surface, shape=shape, r_inner=0.03)
    shell = ellipsoid(400)
    scene = Scene.assemble(
        voxmap, shell, bare, inner=3.0, outer=3.0, sampling="trilinear"
    )
    p = scene.laplace.solve(scene.b)
    sliding = Sliding.of(voxmap, shell, bare, acts_at)
    rows = GlobalCoulomb(scene, acts_at).rows
    force = (scene.N @ p - mu * (rows.force @ p)).reshape(-1, 3)
    force -= viscous * sliding.velocity
    torque = (scene.W @ p - mu * (rows.torque @ p)).reshape(-1, 3)
    torque -= np.cross(sliding.arm, viscous * sliding.velocity)
    return replace(scene, trajectory=replace(bare, force=force, torque=torque))


DRAG = {"friction_coefficient": 0.3}
TWIST = np.array([0.03, -0.02, 0.05, 0.4, 0.2, -0.3])


def pressing(scene, parameters=None):
    """The Laplace field of a scene, which pushes."""
    values = scene.voxmap.grid.unflatten(scene.laplace.solve(scene.b))
    return PotentialField(scene.voxmap, values, scene.sampling, parameters or {})


def deepest_pose(scene):
    k = int(scene.rows.contact_points.argmax())
    return scene.trajectory.rotation[k], scene.trajectory.position[k]


def scaled(field, factor, parameters=None):
    """A field times a number, by itself with the same parameters."""
    own = field.parameters if parameters is None else parameters
    return replace(field, values=factor * field.values, parameters=own)


def built_c(source, tmp_path_factory, *flags):
    """A C file as a library; the test is left out without a compiler, or the file."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None or not source.exists():
        pytest.skip("no C compiler here, or no C file")
    built = tmp_path_factory.mktemp("c") / f"{source.stem}.so"
    shared = ["-Werror", "-shared", "-fPIC", str(source), "-lm", "-o", str(built)]
    subprocess.run([compiler, *flags, *shared], check=True)
    return ctypes.CDLL(str(built))
