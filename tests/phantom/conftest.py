import pytest

from ttus_opt.phantom import Torso, TorsoMesh, skin_compliance, torso_body


@pytest.fixture(scope="session")
def coarse_body():
    return torso_body(Torso(), TorsoMesh(resolution=4.0))


@pytest.fixture(scope="session")
def coarse_patch(coarse_body):
    return skin_compliance(coarse_body)
