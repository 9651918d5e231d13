"""Recordings that lie on the skin only in another frame are told."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.kit import MistakeWarning, presses, torso
from ttus_opt.fitting.checks import frame_check
from ttus_opt.probe.conventions import Conventions
from ttus_opt.probe.rigid_motion import as_rows, inverse

TURN = Rotation.from_rotvec([1.0, 0.5, -2.0]).as_matrix()
SKIN = replace(torso(), axis=tt.Axis(np.array([0.4, -0.1, 0.9]), TURN))
SHELL = tt.PointShell.ellipsoid((0.02, 0.015, 0.015), n_points=50)
OWN = presses(SKIN, 12, np.random.default_rng(5))
PLACE = SKIN.axis.scan_to_patient


def told(written, conventions):
    read = conventions.read(written, SHELL.reference, PLACE)
    frame_check.warn_of_another_frame(written, read, SHELL, SKIN, conventions)


def test_the_share_is_that_of_frames_near_the_skin():
    assert frame_check.share_near_skin(OWN, SHELL, SKIN) == 1.0
    away = OWN.position.copy()
    away[:3] *= 5.0  # out
    away[3:6, 2] += 1.0  # beyond the head
    there = replace(OWN, position=away)
    assert frame_check.share_near_skin(there, SHELL, SKIN) == pytest.approx(0.5)


def test_nothing_is_said_of_the_right_frame():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        told(OWN, Conventions())
        told(OWN.transformed(inverse(PLACE)), Conventions(frame="scan"))
        # nor where scan and patient are one frame
        one = replace(SKIN, axis=tt.Axis.identity())
        frame_check.warn_of_another_frame(OWN, OWN, SHELL, one, Conventions())


def test_the_frame_that_fits_is_named():
    with pytest.warns(
        MistakeWarning, match=r"100 % .* in the scan frame: .*--frame scan"
    ):
        told(OWN.transformed(inverse(PLACE)), Conventions())
    with pytest.warns(MistakeWarning, match="read them with --frame patient"):
        told(OWN, Conventions(frame="scan"))


def test_recordings_near_no_skin_at_all():
    away = replace(OWN, position=OWN.position + 3.0)
    with pytest.warns(
        MistakeWarning, match="only 0 % .* within 10 cm .*--base-to-scan"
    ):
        told(away, Conventions())
    motion = as_rows(np.eye(4))
    with pytest.warns(MistakeWarning, match="is --base-to-scan right"):
        told(away, Conventions(frame="base", base_to_scan=motion))


def test_a_motion_the_wrong_way_round_is_told():
    base_to_scan = np.eye(4)
    base_to_scan[:3, :3] = TURN.T
    base_to_scan[:3, 3] = 0.7, 0.2, -0.5
    written = OWN.transformed(inverse(PLACE), inverse(base_to_scan))
    right = Conventions(frame="base", base_to_scan=as_rows(base_to_scan))
    told(written, right)
    wrong = replace(right, base_to_scan=as_rows(inverse(base_to_scan)))
    with pytest.warns(MistakeWarning, match="with the inverse of base_to_scan"):
        told(written, wrong)


def path(n, step=0.01):
    """A slow circle of 5 cm, in n frames with jitter of a tenth of a millimetre."""
    time = step * np.arange(n)
    turned = np.stack([np.cos(time), np.sin(time), 0.0 * time], axis=1)
    noise = np.random.default_rng(0).normal(0.0, 1e-4, (n, 3))
    return 0.05 * turned + noise, time


def test_a_jump_is_where_it_is_and_as_large():
    position, time = path(100)
    position[40:] += [0.0, 0.02, 0.0]
    at, size = frame_check.jumps(position, time)
    assert np.flatnonzero(at).tolist() == [40]
    assert size[40] == pytest.approx(0.02, rel=0.1)


def test_what_is_no_jump():
    """A few frames, a brisk start between sparse frames, and steps as all others."""
    for n in (1, 3):
        assert not frame_check.jumps(*path(n))[0].any()
    position, time = path(12, step=0.1)
    position[6:, 0] += 0.05  # 0.5 m/s for 0.1 s
    assert not frame_check.jumps(position, time)[0].any()
    rough, time = path(100)
    rough += np.random.default_rng(1).normal(0.0, 0.02, rough.shape)
    assert not frame_check.jumps(rough, time)[0].any()
    position, time = path(100)
    position[50] += [0.0, 0.0, 0.02]  # there and back: two steps, each unlike its own
    assert np.flatnonzero(frame_check.jumps(position, time)[0]).tolist() == [50, 51]
