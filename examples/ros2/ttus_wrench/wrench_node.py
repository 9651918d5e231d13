"""The node: PoseStamped in, WrenchStamped out at its rate, swap by a service.

Topics ``probe_pose`` and ``wrench``; service ``~/swap`` loads the file that the
parameter ``field_file`` names by then.
"""

from __future__ import annotations

import time
from dataclasses import MISSING, fields

import rclpy
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from ttus_opt.core.errors import InputError, TtusError
from ttus_wrench.wrench_loop import Settings, WrenchLoop


class WrenchNode(Node):
    """Renders a field for the newest pose."""

    def __init__(self) -> None:
        super().__init__("ttus_wrench")
        given = {}
        for each in fields(Settings):
            value = "" if each.default is MISSING else each.default
            given[each.name] = self.declare_parameter(each.name, value).value
        self.loop = WrenchLoop(Settings(**given))
        # poses and ticks take turns; a swap, which reads a file, runs beside them
        turns, beside = (
            MutuallyExclusiveCallbackGroup(),
            MutuallyExclusiveCallbackGroup(),
        )
        self.out = self.create_publisher(WrenchStamped, "wrench", 1)
        self.create_subscription(
            PoseStamped, "probe_pose", self.on_pose, 1, callback_group=turns
        )
        period = 1.0 / self.loop.settings.rate
        self.create_timer(period, self.on_tick, callback_group=turns)
        self.create_service(Trigger, "~/swap", self.on_swap, callback_group=beside)

    def on_pose(self, message: PoseStamped) -> None:
        """Keep a pose; one that is refused is told, once a second."""
        p, q = message.pose.position, message.pose.orientation
        stamp = message.header.stamp
        try:
            self.loop.take(
                message.header.frame_id,
                stamp.sec + 1e-9 * stamp.nanosec,
                (p.x, p.y, p.z),
                (q.x, q.y, q.z, q.w),
                time.monotonic(),
            )
        except InputError as error:
            self.get_logger().warning(str(error), throttle_duration_sec=1.0)

    def on_tick(self) -> None:
        """Publish the wrench of the newest pose."""
        wrench = self.loop.tick(time.monotonic())
        if wrench is None:
            return
        answer = WrenchStamped()
        answer.header.stamp = self.get_clock().now().to_msg()
        answer.header.frame_id = self.loop.settings.frame_id
        force, torque = answer.wrench.force, answer.wrench.torque
        force.x, force.y, force.z, torque.x, torque.y, torque.z = wrench.tolist()
        self.out.publish(answer)

    def on_swap(
        self, request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        """Blend in the field that the parameter names."""
        name = self.get_parameter("field_file").value
        try:
            self.loop.swap(name)
        except TtusError as error:
            response.success, response.message = False, str(error)
        else:
            response.success, response.message = True, f"blending in {name}"
        return response


def main() -> None:
    """Spin until interrupted."""
    rclpy.init()
    node = WrenchNode()
    executor = MultiThreadedExecutor(num_threads=2)
    executor.add_node(node)
    try:
        executor.spin()
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
