"""Runs of frames: presses, and places within them."""

import numpy as np

from ttus_opt.contact.places import places, runs


def test_a_run_ends_with_contact_and_with_a_recording():
    touching = np.array([False, True, True, False, False, True, True])
    segment = np.array([0, 0, 0, 0, 1, 1, 2])
    assert runs(touching, segment).tolist() == [0, 1, 1, 2, 3, 4, 5]


def test_a_place_ends_with_a_press_and_where_the_probe_has_moved_on():
    along = np.zeros((7, 3))
    along[:, 2] = [0.0, 0.01, 0.02, 0.05, 0.06, 0.06, 0.06]
    press = np.array([0, 0, 0, 0, 0, 4, 4])
    assert places(press, along).tolist() == [0, 0, 0, 1, 1, 2, 2]


def test_the_size_of_a_place_may_be_told():
    press = np.zeros(4, dtype=np.int64)
    along = np.column_stack([0.01 * np.arange(4), np.zeros(4), np.zeros(4)])
    assert places(press, along, 0.015).tolist() == [0, 0, 1, 1]
