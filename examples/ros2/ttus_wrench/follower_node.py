"""The patient's side of a live session with a robot that speaks ROS 2.

``robot_pose`` (PoseStamped, the probe in the patient frame) and ``robot_wrench``
(WrenchStamped, on the probe, patient axes, gravity taken off) in, ``robot_target``
(PoseStamped) out, a hundred times a second. Not a medical device: the robot's own
limits of force, speed and workspace are what protects people.
"""

from __future__ import annotations

import time

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, WrenchStamped
from numpy.typing import NDArray
from rclpy.node import Node

from ttus_opt import PointShell, Surface
from ttus_opt.core.errors import InputError
from ttus_opt.live.driven_patient import DrivenPatient
from ttus_opt.live.follower import Follower
from ttus_opt.live.links import open_link
from ttus_opt.live.model import USUAL_LAW
from ttus_opt.live.sealing import read_key
from ttus_opt.live.trial import prepared
from ttus_opt.probe.pose import pose_of, to_quaternions

#: Parameters and their defaults
PARAMETERS = {
    "link": "udp",
    "key": "session.key",
    "host": "0.0.0.0",
    "port": 7411,
    "surface_file": "surface.nc",
    "probe": "ellipsoid:0.030,0.0125,0.018",
    "frame_id": "patient",
}

RATE = 100.0


class FollowerNode(Node):
    """Joins the robot's messages, and steps the follower once they came."""

    def __init__(self) -> None:
        super().__init__("ttus_follower")
        given = {
            name: self.declare_parameter(name, value).value
            for name, value in PARAMETERS.items()
        }
        skin = Surface.load(given["surface_file"])
        shell = PointShell.from_spec(given["probe"], n_points=1000)
        content = prepared(1.0, USUAL_LAW, skin, shell)
        self.side = Follower(int(time.time()), skin, content)
        secret, place = read_key(given["key"]), (given["host"], given["port"])
        self.link = open_link(given["link"], secret, *place, calls=False)
        self.side.peer.rate.overhead = self.link.overhead
        self.frame_id = given["frame_id"]
        self.patient = DrivenPatient(self.command)
        self.target: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
        self.out = self.create_publisher(PoseStamped, "robot_target", 1)
        self.create_subscription(PoseStamped, "robot_pose", self.on_pose, 1)
        self.create_subscription(WrenchStamped, "robot_wrench", self.on_wrench, 1)
        self.create_timer(1.0 / RATE, self.on_tick)

    def on_pose(self, message: PoseStamped) -> None:
        """Keep a pose of the patient frame; another is told, and silence then stops."""
        p, q = message.pose.position, message.pose.orientation
        try:
            if message.header.frame_id != self.frame_id:
                raise InputError(f"a pose in {message.header.frame_id!r}")
            pose = pose_of((q.x, q.y, q.z, q.w), (p.x, p.y, p.z), "xyzw")
            self.patient.take_pose(time.monotonic(), *pose)
        except InputError as error:
            self.get_logger().warning(str(error), throttle_duration_sec=1.0)

    def on_wrench(self, message: WrenchStamped) -> None:
        """Keep a wrench."""
        parts = message.wrench.force, message.wrench.torque
        wrench = np.array([getattr(part, axis) for part in parts for axis in "xyz"])
        self.patient.take_wrench(time.monotonic(), wrench)

    def on_tick(self) -> None:
        """A frame, from the first pose and wrench on."""
        now = time.monotonic()
        if self.target is None:
            if not self.patient.ready(now):
                return
            self.target = self.patient.here
        sensed = self.patient.sense(now, *self.target)
        step = self.side.step(now, self.link.receive(now), sensed)
        self.link.send(now, step.send)
        self.target = step.rotation, step.position

    def command(
        self, rotation: NDArray[np.float64], position: NDArray[np.float64]
    ) -> None:
        """Publish the target."""
        message = PoseStamped()
        message.header.frame_id = self.frame_id
        message.header.stamp = self.get_clock().now().to_msg()
        p, q = message.pose.position, message.pose.orientation
        p.x, p.y, p.z = position.tolist()
        q.w, q.x, q.y, q.z = to_quaternions(rotation[None])[0].tolist()
        self.out.publish(message)


def main() -> None:
    """Spin until interrupted."""
    rclpy.init()
    node = FollowerNode()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.link.close()
        node.destroy_node()
        rclpy.try_shutdown()
