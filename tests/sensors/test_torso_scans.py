"""A real torso's skin seen by three depth cameras: how near the surface comes.

Depths of the CT's mesh, ray by ray, with the noise of structured light, a tenth of the
pixels missing, flying pixels at every edge, whole millimetres, and a bed. And a real
depth camera's points in two views, put back on each other.
"""

import json
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.kit import shared_data
from tests.scan.camera import radius_by_section
from tests.sensors.cameras import (
    Camera,
    flying,
    measured,
    millimetres,
    see_mesh,
    see_plane,
)
from ttus_opt.cli import main
from ttus_opt.core.arrays import Array
from ttus_opt.sensors.depth import DepthImage
from ttus_opt.sensors.depth_noise import noise_model
from ttus_opt.sensors.intrinsics import Intrinsics
from ttus_opt.sensors.stitching import PoseUncertainty, stitch
from ttus_opt.sensors.unprojection import Unprojection

UP = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True)
class Torso:
    vertices: Array
    faces: NDArray[np.int64]

    @property
    def ends(self):
        return float(self.vertices[:, 2].min()), float(self.vertices[:, 2].max())


@cache
def torso():
    path = shared_data("torso/ct_skin_mm.ply")
    import trimesh

    mesh = trimesh.load(path, process=False)
    return Torso(1e-3 * np.asarray(mesh.vertices, float), np.asarray(mesh.faces))


@cache
def cameras():
    """From the front and from both sides, 0.9 m off, as tests/scan has them."""
    body = torso().vertices
    middle = (body.min(axis=0) + body.max(axis=0)) / 2
    found = []
    for direction in ((0, -1, 0), (-1, -0.45, 0), (1, -0.45, 0)):
        ray = np.array(direction) / np.linalg.norm(direction)
        down = (1.0, 0.0, 0.0) if direction[0] == 0 else (0.0, -1.0, 0.0)
        eye = tuple(middle - 0.9 * ray)
        found.append(Camera(eye, tuple(middle), (240, 320), 300.0, down))
    return tuple(found)


@cache
def depths(k):
    """What camera k measures, z [m]."""
    camera, body = cameras()[k], torso()
    skin = see_mesh(camera, body.vertices, body.faces)
    low, high = body.ends
    bed = see_plane(camera, UP, float(body.vertices[:, 1].min()))
    z = np.minimum(skin, np.where(bed < 1.6, bed, np.inf))
    height = camera.eye[2] + np.where(np.isfinite(z), z, 0) * camera.rays[..., 2]
    # the real body goes on beyond the CT's ends: rays that meet them saw nothing
    end = (skin <= bed) & ((height < low + 0.002) | (height > high - 0.002))
    z = np.where(end, np.inf, z)
    rng = np.random.default_rng(k)
    with np.errstate(invalid="ignore"):
        mixed = flying(z, rng)
        std = 0.0012 + 0.0019 * (mixed - 0.4) ** 2  # Nguyen et al. 2012, facing
        std = np.where(np.isfinite(std), std, 0.0)
    return measured(mixed, std, 0.1, rng)


def written(folder, poses):
    """Images, camera and poses as files; the words of the command."""
    lines = ["t,px,py,pz,qw,qx,qy,qz"]
    for k, pose in enumerate(poses):
        assert cv2.imwrite(str(folder / f"{k}.png"), millimetres(depths(k)))
        q = Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True)
        lines.append(",".join(f"{v:.9f}" for v in [k, *pose[:3, 3], *q]))
    (folder / "poses.csv").write_text("\n".join(lines) + "\n")
    (folder / "camera.json").write_text(json.dumps({"K": cameras()[0].matrix.tolist()}))
    images = [str(folder / f"{k}.png") for k in range(len(poses))]
    return [
        *["surface", *images, "--intrinsics", str(folder / "camera.json")],
        *["--poses", str(folder / "poses.csv"), "--noise", "structured-light"],
        *["--json", "-o", str(folder / "surface.nc")],
    ]


def errors(found):
    """Errors of the radius where it was seen, off the CT's ends [m]."""
    body = torso()
    vertices = found.axis.to_patient(body.vertices)
    truth = radius_by_section(vertices, body.faces, found.theta, found.z)
    nodes = np.stack(
        [
            truth * np.cos(found.theta)[:, None],
            truth * np.sin(found.theta)[:, None],
            np.broadcast_to(found.z, truth.shape),
        ],
        axis=-1,
    )
    height = found.axis.to_scan(nodes.reshape(-1, 3))[:, 2].reshape(truth.shape)
    low, high = body.ends
    inside = (height > low + 0.003) & (height < high - 0.003)
    kept = found.observed & inside & np.isfinite(truth)
    assert kept.sum() > 0.9 * found.observed.sum()
    return np.asarray((found.radius - truth)[kept])


def run(words, capsys):
    with pytest.raises(SystemExit) as stop:
        main(words)
    printed = capsys.readouterr()
    assert not stop.value.code, printed.err
    return dict(json.loads(printed.out))


@pytest.mark.slow
def test_three_sides(tmp_path, capsys):
    """Mean ≤ 1.0 mm and 95 % ≤ 3 mm where seen."""
    words = written(tmp_path, [camera.pose for camera in cameras()])
    told = run(words, capsys)
    found = tt.Surface.load(tmp_path / "surface.nc")
    off = np.abs(errors(found))
    print(f"mean {1e3 * off.mean():.2f} mm, 95 % {1e3 * np.percentile(off, 95):.2f} mm")
    assert told["observed"] > 0.6
    assert off.mean() < 0.6e-3  # asked: 1.0 mm
    assert np.percentile(off, 95) < 1.6e-3  # asked: 3 mm
    # the deviations told are those found
    ratio = np.std(errors(found)) / np.median(found.radius_std[found.observed])
    assert 0.6 < ratio < 1.7


def real_views(apart):
    """Every second point of a RealSense's cloud in one view, the others in another."""
    path = shared_data("torso/realsense_male_m.pcd")
    points = tt.read_cloud(path, unit="m")
    x, y, _ = (points.min(axis=0) + points.max(axis=0)) / 2
    seen, images = [], []
    for k, side in enumerate((-1, 1)):
        camera = Camera(
            (x + side * apart, y + 0.1 * side, 0.65), (x + 0.3 * side * apart, y, -0.1)
        )
        own = (points[k::2] - camera.pose[:3, 3]) @ camera.pose[:3, :3]
        u, v, _ = np.rint(camera.matrix @ (own / own[:, 2:]).T).astype(int)
        inside = (u >= 0) & (u < 160) & (v >= 0) & (v < 120)
        z = np.full(camera.shape, np.inf)
        np.minimum.at(z, (v[inside], u[inside]), own[inside, 2])
        rays = Unprojection.from_intrinsics(
            Intrinsics(camera.matrix, np.zeros(0)), (120, 160)
        )
        seen.append(camera)
        images.append(DepthImage(np.where(np.isfinite(z), z, np.nan), rays))
    return seen, images


@pytest.mark.slow
@pytest.mark.parametrize(("apart", "most"), [(0.0, 0.8), (0.1, 0.9), (0.2, 1.4)])
def test_real_points_are_put_back(apart, most):
    """Noise, holes, table and arm stub of a real camera; 6 mm and 0.5° off."""
    pytest.importorskip("small_gicp", reason="needs ttus-opt[sensors]")
    seen, images = real_views(apart)
    change = np.eye(4)
    turn = Rotation.from_rotvec(np.deg2rad([0.3, -0.3, 0.3]))
    change[:3, :3], change[:3, 3] = turn.as_matrix(), [0.0035, 0.0035, -0.0035]
    points = images[1].to_cloud().points

    def off(first, second):
        """How far the second view's points are, as the first sees them [mm]."""
        to_first = np.linalg.inv(first) @ second
        true = np.linalg.inv(seen[0].pose) @ seen[1].pose
        e = np.linalg.inv(true) @ to_first
        moved = points @ e[:3, :3].T + e[:3, 3]
        return float(1e3 * np.linalg.norm(moved - points, axis=1).mean())

    measured_poses = [seen[0].pose, seen[1].pose @ change]
    found = stitch(
        images,
        measured_poses,
        noise=noise_model("stereo:0.05"),
        refine=PoseUncertainty(),
    )
    before, after = off(*measured_poses), off(*found.poses)
    told = found.refinements[0]
    print(
        f"{apart} m: {before:.2f} → {after:.2f} mm, residual "
        f"{1e3 * told.residual_before:.2f} → {1e3 * told.residual:.2f} mm, condition "
        f"{told.condition:.0f}"
    )
    assert before > 3.0
    assert after < most
    assert told.residual < 0.5 * told.residual_before
