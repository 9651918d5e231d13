"""Fixtures of all tests, and how they are collected and shared out."""

import gc
import signal

import pytest
from hypothesis import HealthCheck, settings

from tests.kit import shared_data, small_scene

# a slow machine is no fault, and no run fails by chance: the same examples every time;
# `--hypothesis-profile=search` looks for others
settings.register_profile(
    "search", deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile("steady", settings.get_profile("search"), derandomize=True)
settings.load_profile("steady")

# a shell has what it runs in the background ignore interrupts, with all its children
signal.signal(signal.SIGINT, signal.default_int_handler)

# of what files of tests hold nothing is garbage: rounds of the collector are rare
gc.set_threshold(100_000, 20, 50)


def pytest_collection_finish():
    """Leave out of the collector's rounds what lives as long as the tests do."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(wrapper=True)
def pytest_collect_file(file_path):
    """Test files have no examples to run; helpers beside them may."""
    found = yield
    if file_path.name.startswith("test_"):
        return [one for one in found if type(one) is pytest.Module]
    return found


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Let a process run tests in a row: what they set up is made once."""
    from xdist.scheduler import WorkStealingScheduling

    return WorkStealingScheduling(config, log)


@pytest.fixture(scope="session")
def shared():
    """Folder of the real and independent data, or a skip."""
    return shared_data()


@pytest.fixture(scope="session", params=["voxel-mean", "trilinear"])
def scene(request):
    """A small scene in each sampling."""
    return small_scene(request.param)
