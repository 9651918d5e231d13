"""What single steps of a session start from."""

from ttus_opt.phantom.example_data import true_surface
from ttus_opt.sensors.stream_files import read_wrenches
from ttus_opt.session.registration import probe_poses, register

SURFACE = true_surface()


def forces(session):
    stream = session.force.stream
    return read_wrenches(stream.file, stream.name, stream.columns)


def streams(session):
    frames = register(session.tracker, SURFACE)
    return frames, probe_poses(session.tracker, frames), forces(session)
