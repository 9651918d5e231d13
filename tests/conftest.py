"""Fixtures of all tests, and how they are collected and shared out."""

import gc

import pytest

from tests.kit import shared_data, small_scene

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
