"""A simulated hand on any skin, with any probe; tissue below it."""

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError, shared_data
from ttus_opt.contact.standing import depth_of
from ttus_opt.live.subject import LIFTED, MEETING, PRESS, WAY, Subject, shell_of
from ttus_opt.live.tissue import TORSO_LAW, VARIES, FieldTissue
from ttus_opt.live.trial import Trial, simulation
from ttus_opt.probe.held import hold
from ttus_opt.viewer.state import ViewState

RADIUS = 0.12


@pytest.fixture(scope="module")
def cylinder():
    z = np.linspace(-0.1, 0.2, 31)
    return tt.Surface.from_radius(np.full((120, 31), RADIUS), z)


def test_the_hand_presses_with_the_face_that_was_named(cylinder):
    shell = tt.PointShell.box((0.05, 0.12, 0.02), 600)
    who = Subject(cylinder, shell, hold(("-y", "z")))
    path = who.examination()
    outward = path.position[0] / np.linalg.norm(path.position[0])
    np.testing.assert_allclose(path.rotation[0][:, 1], [0.0, 1.0, 0.0], atol=0.1)
    np.testing.assert_allclose(path.rotation[0][:, 2], [0.0, 0.0, 1.0], atol=1e-6)
    assert outward[1] > 0.9  # in front
    depth = depth_of(cylinder, shell, path.rotation, path.position)
    assert depth[0] == pytest.approx(LIFTED, abs=2e-4)
    deepest = np.searchsorted(path.time, MEETING + 0.5 * PRESS)
    assert depth[deepest] == pytest.approx(LIFTED + WAY, abs=2e-3)


def test_a_place_beyond_the_surface(cylinder):
    with pytest.raises(InputError, match="must lie on the surface"):
        Subject(cylinder, shell_of("sphere:0.02"), place=(0.0, 0.4))


@pytest.mark.slow
def test_below_a_sphere_tissue_follows_its_law(cylinder):
    ball, depth = tt.PointShell.sphere(0.01, 3000), 0.006
    tissue = FieldTissue.below(cylinder, ball)
    angles = np.linspace(0.0, 2.0 * np.pi, 90, endpoint=False)
    out = np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    felt = []
    for height in np.linspace(0.0, 0.08, 8, endpoint=False):  # over a whole wave
        for along in out:
            at = (RADIUS + 0.01 - depth) * along + [0.0, 0.0, height]
            force = tissue.wrench(np.eye(3), at, np.zeros(3))[:3]
            felt.append(force @ along)
    # pressure over the cap's projection: ∫ φ(sunk) 2πr dr, by the size; N/cm², cm²
    r = (np.arange(4000) + 0.5) / 4000 * 0.01
    sunk = depth - (0.01 - np.sqrt(0.01**2 - r**2)) - r**2 / (4.0 * RADIUS)
    sunk = np.maximum(sunk, 0.0)
    spread = np.sum(sunk * r**3) / np.sum(sunk * r)
    size = 0.01 / np.sqrt(ball.rms_radius**2 + 12.0 * spread)
    whole = size * np.sum(TORSO_LAW(sunk) * 2.0 * np.pi * r) * 0.01 / 4000
    assert np.mean(felt) == pytest.approx(1e4 * whole, rel=0.05)
    # stiffer here, softer there; the ball feels means over its width
    assert 0.7 < np.ptp(felt) / np.mean(felt) / (2.0 * VARIES) < 1.0


def test_the_page_holds_it_likewise(cylinder):
    shell, held = tt.PointShell.box((0.05, 0.12, 0.02), 600), hold(("-y", "z"))
    session = simulation(Trial(round_trip=0.0), Subject(cylinder, shell, held))
    for _ in session.run(0.1):
        pass
    state = ViewState([session.operator.model.field], shell, usual=held)
    state.press(0.004)
    assert state.pose[0][:, 1] @ state.outward == pytest.approx(1.0)


@pytest.mark.slow
def test_a_scanned_torso_is_felt_with_a_real_probe():
    """What `live page --surface --probe` shows, without the page."""
    cloud = tt.read_cloud(shared_data("torso/realsense_male_m.pcd"), unit="m")
    axis = tt.Axis.from_cloud(cloud, head=[1.0, 0.0, 0.0])
    surface = tt.extract_surface(cloud, axis=axis, n_theta=180, n_z=60)
    with pytest.warns(tt.TtusWarning, match="open by"):
        shell = shell_of(str(shared_data("probe/Probe_L14-5_38_lowres.stl")))
    who = Subject(surface, shell, hold(("-y", "z")))
    session = simulation(Trial(round_trip=0.2, prior=1.6), who)
    errors = []
    for k, moment in enumerate(session.run(12.0)):
        if k % 50 == 0 and moment.time > 8.0:
            pose = moment.rotation, moment.position
            true = session.patient.tissue.wrench(*pose, np.zeros(3))[:3]
            if np.linalg.norm(true) > 0.5:
                errors.append(np.linalg.norm(moment.felt[:3] - true))
    assert len(errors) > 30
    assert np.mean(errors) < 0.36
    assert session.operator.peer.safety.cause == ""
