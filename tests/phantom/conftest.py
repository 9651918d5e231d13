import pytest

from ttus_opt.phantom.elasticity import skin_compliance
from ttus_opt.phantom.torso import Torso, TorsoMesh, torso_body


@pytest.fixture(scope="session")
def coarse_body():
    return torso_body(Torso(), TorsoMesh(resolution=4.0))


@pytest.fixture(scope="session")
def coarse_patch(coarse_body):
    return skin_compliance(coarse_body)
