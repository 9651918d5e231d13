"""Poses and forces in the picture are those of the recording."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.quiver import Quiver

import ttus_opt as tt
from tests.kit import InputError, ellipsoid, presses, torso
from ttus_opt.report.plots import poses
from ttus_opt.report.plots.poses import LONGEST


def drawn(recorded, surface=None):
    return tt.plots.pose_picture(surface or torso(), ellipsoid(), recorded)


def recording():
    return presses(torso(), 12, np.random.default_rng(0))


def arrows(axes):
    """Where the arrows of a projection begin, and where they point, (n, 2) [cm]."""
    found = [c for c in axes.collections if isinstance(c, Quiver)]
    begin = np.concatenate([q.XY for q in found])
    return begin, np.concatenate([np.stack([q.U, q.V], axis=1) for q in found])


def ordered(rows):
    return rows[np.lexsort(rows.T)]


def test_arrows_are_the_forces_in_each_projection():
    recorded = recording()
    figure = drawn(recorded)
    at = recorded.position + recorded.rotation @ ellipsoid().reference
    longest = float(figure.get_suptitle().split("= ")[1].split(" N")[0])
    for panel, axes in zip(figure.axes, ([2, 0], [2, 1], [0, 1]), strict=True):
        labels = panel.get_xlabel(), panel.get_ylabel()
        assert labels == tuple(f"{'xyz'[i]} [cm]" for i in axes)
        begin, along = arrows(panel)
        np.testing.assert_allclose(ordered(begin), ordered(100 * at[:, axes]))
        np.testing.assert_allclose(
            ordered(along) * longest / LONGEST, ordered(recorded.force[:, axes])
        )


def test_frames_are_told_by_what_touches():
    recorded = recording()
    lifted, silent = 3, 5
    position, force = recorded.position.copy(), np.array(recorded.force)
    position[lifted, :2] *= 2.0
    # well inside: shell points are below the skin for sure
    position[silent, :2] *= 0.9
    force[silent] = 0.0
    panel = drawn(replace(recorded, position=position, force=force)).axes[2]
    marks = {line.get_label(): line for line in panel.lines}
    places = 100 * (position + recorded.rotation @ ellipsoid().reference)
    for label, frame in (("contact, no force", silent), ("force, no contact", lifted)):
        assert marks[label].get_xdata() == pytest.approx([places[frame, 0]])


def test_the_seen_side_is_up():
    full = torso()
    seen = np.broadcast_to((np.cos(full.theta) < 0)[:, None], full.radius.shape)
    figure = drawn(recording(), replace(full, observed=seen))
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels == ["y [cm]", "−x [cm]", "−x [cm]"]


def test_a_row_for_each_recording_up_to_a_limit(monkeypatch):
    monkeypatch.setattr(poses, "RECORDINGS", 2)
    three = tt.Trajectory.concatenate([recording()] * 3)
    figure = drawn(three)
    assert len(figure.axes) == 3 * 2
    assert "first 2 of 3" in figure.get_suptitle()
    with pytest.raises(InputError, match="3 recordings"):
        tt.plots.pose_picture(torso(), ellipsoid(), three, ["press.csv"])


def test_poses_without_wrenches_have_no_arrows():
    panel, *_ = drawn(replace(recording(), force=None, torque=None)).axes
    assert not [c for c in panel.collections if isinstance(c, Quiver)]
