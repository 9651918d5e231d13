"""Recordings read otherwise, and what the session's own readings tell."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.fitting.checks.test_sanity import geometry, recording
from ttus_opt.fitting.checks.other_readings import _other_conventions, contact_readings
from ttus_opt.fitting.checks.sanity import likely_mistake
from ttus_opt.probe.conventions import Conventions


def test_delays_are_tried_both_ways_in_even_steps():
    recorded = recording("press_fit")
    usual = Conventions(), np.zeros(3)
    tried = [c.wrench_delay for c in _other_conventions(*usual, recorded)]
    steps = np.diff(sorted(set(tried)))  # with none
    np.testing.assert_allclose(steps, steps[0])
    assert max(tried) == -min(tried) == 0.6
    short = recorded.select(recorded.time < recorded.time[0] + 0.29)
    assert max(c.wrench_delay for c in _other_conventions(*usual, short)) == 0.2


def named(recorded):
    scene = tt.Scene.assemble(*geometry(), recorded, inner=10.0, sampling="trilinear")
    return likely_mistake(scene, recorded, Conventions(), contact_readings(scene))[1]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ttus_opt.TtusWarning")
def test_turned_axes_are_told():
    """Of probe and wrenches, of the probe alone, of wrenches alone; not of neither."""
    own = recording("press_fit")
    assert named(own) is None
    turn = Rotation.from_euler("y", 90, degrees=True).as_matrix()
    turned = own.rotation @ turn @ own.rotation.transpose(0, 2, 1)
    force = np.einsum("tij,tj->ti", turned, own.force)
    torque = np.einsum("tij,tj->ti", turned, own.torque)
    probe = replace(own, rotation=own.rotation @ turn)
    for wrong, cause, what in (
        (
            replace(probe, force=force, torque=torque),
            "probe_axes",
            "probe and wrenches",
        ),
        (probe, "probe_axes", "the probe turned"),
        (replace(own, force=force, torque=torque), "wrench_axes", "wrenches turned"),
    ):
        found = named(wrong)
        assert found.cause == cause
        assert found.what.startswith(what)
        assert found.after < 0.5 * found.before
