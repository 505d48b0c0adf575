"""A learned motion of poses as a ROS 2 node: an example to begin from; it needs rclpy and numpy, and no torch.

    ros2 run ... ros2_node.py --ros-args -p policy:=policy.pt -p goal:="[0.0, 1.0, 0.0, 0.0]" -p frame:=base_link

Publishes the reference of each tick on ~/reference (geometry_msgs/PoseStamped) and ~/velocity (geometry_msgs/TwistStamped),
for the Cartesian impedance controller of your arm, which keeps the limits of the robot. Listens to ~/pose (PoseStamped,
measured) for where to begin, and with feedback:=true for where it is. Services: ~/start and ~/stop (std_srvs/Trigger), ~/pause
(std_srvs/SetBool). A motion that was stopped and has come to rest may be started again.
"""

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, TwistStamped
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from torchds import Controller
from torchds.control import Recorder
from torchds.errors import TorchdsError

COLUMNS = ("x [m]", "y [m]", "z [m]", "rx [rad]", "ry [rad]", "rz [rad]")


def multiply(a, b):
    """The product of quaternions, the scalar first."""
    return np.array(
        [
            a[0] * b[0] - a[1:] @ b[1:],
            *(a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])),
        ]
    )


def quaternion(r, goal):
    """The orientation of a state, q* exp(r/2), as torchds.poses.quaternion has it."""
    angle = np.linalg.norm(r)
    return multiply(goal, np.array([np.cos(angle / 2), *(0.5 * np.sinc(angle / (2 * np.pi)) * r)]))


def rotation_vector(q, goal):
    """r of an orientation, as torchds.poses.rotation_vector has it: of length at most π, for q and −q the same."""
    relative = multiply(goal * [1, -1, -1, -1], q)
    relative = relative if relative[0] >= 0 else -relative
    sine = np.linalg.norm(relative[1:])
    return 2 * np.arctan2(sine, relative[0]) / sine * relative[1:] if sine > 1e-12 else np.zeros(3)


class Motion(Node):
    """The controller of a policy in the executor's timer."""

    def __init__(self):
        super().__init__("torchds_motion")
        self.declare_parameter("policy", "policy.pt")
        self.declare_parameter("goal", [1.0, 0.0, 0.0, 0.0])  # q*, scalar first, as last_orientation has it by default
        self.declare_parameter("frame", "base_link")
        self.declare_parameter("feedback", False)
        self.declare_parameter("max_speed", 0.25)  # of the policy's own bounds; the robot has to have its own
        self.declare_parameter("recording", "")  # a .csv that a session takes back
        self.goal = np.array(self.get_parameter("goal").value)
        self.feedback = self.get_parameter("feedback").value
        self.controller = Controller.load(
            self.get_parameter("policy").value,
            feedback=self.feedback,
            max_speed=self.get_parameter("max_speed").value,
            max_acceleration=2.0,
        )
        self.recorder = Recorder(COLUMNS)
        self.measured, self.began, self.running, self.stopping = None, 0.0, False, False
        self.reference = self.create_publisher(PoseStamped, "~/reference", 1)
        self.velocity = self.create_publisher(TwistStamped, "~/velocity", 1)
        self.create_subscription(PoseStamped, "~/pose", self.look, 1)
        self.create_service(Trigger, "~/start", self.start)
        self.create_service(Trigger, "~/stop", self.stop)
        self.create_service(SetBool, "~/pause", self.pause)
        self.create_timer(self.controller.dt, self.tick)

    def look(self, message):
        """Keep the measured pose as a state [p, r]."""
        p, q = message.pose.position, message.pose.orientation
        r = rotation_vector(np.array([q.w, q.x, q.y, q.z]), self.goal)
        self.measured = np.array([p.x, p.y, p.z, *r])

    def start(self, request, response):
        """Begin where the robot is."""
        response.success = self.measured is not None and not self.running
        response.message = "begins" if response.success else "no pose was measured, or it runs already"
        if response.success:
            self.controller.reset(self.measured)
            self.recorder.length, self.began, self.running, self.stopping = 0, self.now(), True, False
        return response

    def stop(self, request, response):
        """Come to rest on the way, and write what was measured."""
        self.controller.stop()
        self.stopping, response.success = True, True
        if path := self.get_parameter("recording").value:
            try:
                response.message = str(self.recorder.write(path))
            except TorchdsError as error:
                response.success, response.message = False, str(error)
        return response

    def pause(self, request, response):
        """Slow down to a rest, or go on."""
        try:
            (self.controller.pause if request.data else self.controller.resume)()
            response.success = True
        except TorchdsError as error:  # it was stopped
            response.success, response.message = False, str(error)
        return response

    def record(self):
        """Keep where the robot is, while it moves and there is room."""
        if not self.get_parameter("recording").value or self.controller.resting:
            return
        if self.recorder.length < len(self.recorder.rows):
            self.recorder.add(self.now() - self.began, self.measured)
            if self.recorder.length == len(self.recorder.rows):
                self.get_logger().warning("the recording is full: what follows is not kept")

    def now(self):
        """Seconds."""
        return self.get_clock().now().nanoseconds * 1e-9

    def tick(self):
        """One step of the motion, to the robot."""
        if not self.running:
            return
        tick = self.controller.step(self.measured) if self.feedback else self.controller.step()
        if tick.late > 0.01:
            self.get_logger().warning(f"a tick came {1e3 * tick.late:.0f} ms late")
        self.record()
        self.running = not (self.stopping and self.controller.resting)
        pose, twist = PoseStamped(), TwistStamped()
        pose.header.stamp = twist.header.stamp = self.get_clock().now().to_msg()
        pose.header.frame_id = twist.header.frame_id = self.get_parameter("frame").value
        q = quaternion(tick.x[3:], self.goal)
        pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = map(float, tick.x[:3])
        o = pose.pose.orientation
        o.w, o.x, o.y, o.z = map(float, q)
        twist.twist.linear.x, twist.twist.linear.y, twist.twist.linear.z = map(float, tick.v[:3])
        ahead = quaternion(tick.x[3:] + tick.v[3:] * self.controller.dt, self.goal)
        turn = multiply(ahead, q * [1, -1, -1, -1])[1:] * (2 / self.controller.dt)  # in the base frame, small angles
        twist.twist.angular.x, twist.twist.angular.y, twist.twist.angular.z = map(float, turn)
        self.reference.publish(pose)
        self.velocity.publish(twist)


def main():
    """Spin until it is interrupted."""
    rclpy.init()
    node = Motion()
    try:
        rclpy.spin(node)
    finally:
        node.destroy_node()
        rclpy.shutdown()


if __name__ == "__main__":
    main()
