"""What single steps of a session start from."""

from ttus_opt.phantom.example_data import true_surface
from ttus_opt.session.readings import read_forces
from ttus_opt.session.registration import probe_poses, register

SURFACE = true_surface()


def streams(session):
    frames = register(session.tracker, SURFACE)
    return frames, probe_poses(session.tracker, frames), read_forces(session)
