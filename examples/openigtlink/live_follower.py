"""The patient's side of a live session with a robot that speaks OpenIGTLink.

    python live_follower.py session.key 192.0.2.9 18944 surface.nc probe.stl [webrtc]

The robot's server sends the pose of the probe in the patient frame as TRANSFORM `Probe`
[mm] and what its sensor feels as SENSOR `Wrench`, six numbers [N, N m], gravity taken
off. It is sent the target as TRANSFORM `ProbeTarget`. Not a medical device: the robot's
own limits of force, speed and workspace are what protects people.
"""

from __future__ import annotations

import socket
import sys
import time

import numpy as np
import pyigtl

from ttus_opt import PointShell, Surface
from ttus_opt.core.errors import InputError
from ttus_opt.live.driven_patient import DrivenPatient
from ttus_opt.live.follower import Follower
from ttus_opt.live.links import open_link
from ttus_opt.live.model import USUAL_LAW
from ttus_opt.live.real_time import promptly, run_follower
from ttus_opt.live.sealing import read_key
from ttus_opt.live.trial import prepared
from ttus_opt.sensors.open_igt_message import MessageReader

#: Devices of the robot's server; port of the session
POSE, WRENCH, TARGET, PORT = "Probe", "Wrench", "ProbeTarget", 7411


class IgtRobot:
    """A robot's server: `patient` is what `run_follower` wants."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.create_connection((host, port), timeout=5.0)
        self._socket.setblocking(False)
        self._reader = MessageReader()
        self.patient = DrivenPatient(self._command, self.poll)

    def poll(self) -> None:
        """Take what came. A message with a fault is dropped: silence then stops."""
        while True:
            try:
                data = self._socket.recv(65536)
            except BlockingIOError:
                return
            if not data:
                raise InputError("the robot has closed the connection")
            now = time.monotonic()
            for message in self._reader.feed(data):
                if message.fault:
                    continue
                if message.device == POSE:
                    matrix = message.values
                    self.patient.take_pose(now, matrix[:3, :3], 1e-3 * matrix[:3, 3])
                elif message.device == WRENCH and len(message.values) == 6:
                    self.patient.take_wrench(now, message.values)

    def close(self) -> None:
        """End the connection."""
        self._socket.close()

    def _command(self, rotation: np.ndarray, position: np.ndarray) -> None:
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = rotation, 1e3 * position
        target = pyigtl.TransformMessage(matrix, device_name=TARGET)
        try:
            self._socket.sendall(target.pack())
        except BlockingIOError as error:
            raise InputError("the robot does not read its targets") from error


def main(
    key: str, host: str, port: str, surface: str, probe: str, link: str = "udp"
) -> None:
    """Wait for the robot, then for an operator; Ctrl-C ends it."""
    skin, shell = Surface.load(surface), PointShell.from_spec(probe, n_points=1000)
    content = prepared(1.0, USUAL_LAW, skin, shell)
    side = Follower(int(time.time()), skin, content)
    robot = IgtRobot(host, int(port))
    begun = time.monotonic()
    while not robot.patient.ready(time.monotonic()):
        if time.monotonic() - begun > 5.0:
            raise InputError(f"the robot sends no {POSE} or no {WRENCH}")
        robot.poll()
        time.sleep(0.01)
    here = robot.patient.here
    opened = open_link(link, read_key(key), "0.0.0.0", PORT, calls=False)
    promptly()
    print(run_follower(side, opened, robot.patient, *here))


if __name__ == "__main__":
    if len(sys.argv) not in (6, 7):
        sys.exit(__doc__)
    main(*sys.argv[1:])
