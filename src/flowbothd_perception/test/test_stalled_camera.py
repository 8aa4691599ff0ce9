"""A camera that stalls for two seconds, on a clock that is set by hand: nothing waits."""

from __future__ import annotations

import array

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")
pytestmark = pytest.mark.ros

URDF = (
    '<robot name="toy"><link name="base"/><link name="arm"><collision><origin xyz="0 0 0.2"/>'
    '<geometry><cylinder radius="0.05" length="0.4"/></geometry></collision></link>'
    '<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/>'
    '<origin xyz="0 0 0.2"/><axis xyz="0 1 0"/>'
    '<limit lower="-3" upper="3" effort="1" velocity="1"/></joint></robot>'
)
PARAMETERS = {
    "camera.position": [0.6, 0.0, 1.0],
    "camera.quaternion": [1.0, 0.0, 0.0, 0.0],
    "robot.padded_links": ["arm"],
    "robot.paddings": [0.01],
    "sampling.points": 200,
}
BEGIN = 100.0
OK, ERROR = b"\x00", b"\x02"


class Line:
    """The node without transport: its callbacks are called, what it publishes is kept.

    Stamps and the steady clock are the same, `now`.
    """

    def __init__(self, node, clock):
        self.clock = clock
        self._hear = {s.topic_name: s.callback for s in node.subscriptions}
        self.timers = list(node.timers)
        self.clouds, self.said = [], []
        for publisher in node.publishers:
            if publisher.topic_name == "/object_cloud":
                publisher.publish = self._on_cloud
            elif publisher.topic_name == "/diagnostics":
                publisher.publish = self._on_diagnostics
        self._ticks = 0

    def _on_cloud(self, message):
        stamp = message.header.stamp
        self.clouds.append((self.clock.now, round(stamp.sec + 1e-9 * stamp.nanosec, 3)))

    def _on_diagnostics(self, message):
        status = message.status[0]
        figures = {item.key: item.value for item in status.values}
        self.said.append((self.clock.now, status.level, status.message, figures))

    def describe(self):
        from std_msgs.msg import String

        self._hear["/robot_description"](String(data=URDF))

    def frame(self, stamp):
        from sensor_msgs.msg import CameraInfo, Image

        from flowbothd_common.ros.conversions import to_stamp

        k = [100.0, 0.0, 49.5, 0.0, 100.0, 39.5, 0.0, 0.0, 1.0]
        self._hear["/depth/camera_info"](CameraInfo(width=100, height=80, k=k))
        values = np.full((80, 100), 800, np.uint16)
        message = Image(height=80, width=100, encoding="16UC1", step=200)
        message.data = array.array("B", values.tobytes())
        message.header.stamp = to_stamp(stamp)
        self._hear["/depth/image_raw"](message)

    def run(self, seconds, frames):
        """Let time pass: joint states at 100 Hz, the timer and frames at 10 Hz, or no frames."""
        from sensor_msgs.msg import JointState

        from flowbothd_common.ros.conversions import to_stamp

        for _ in range(round(100 * seconds)):
            self._ticks += 1
            self.clock.now = BEGIN + self._ticks / 100
            message = JointState(name=["turn"], position=[0.0])
            message.header.stamp = to_stamp(self.clock.now)
            self._hear["/joint_states"](message)
            if frames and self._ticks % 10 == 0:
                self.frame(self.clock.now)
            if self._ticks % 10 == 0:
                for timer in self.timers:
                    timer.callback()


@pytest.fixture
def line(monkeypatch):
    """A perception_node on a clock of its own, with the parameters that it has by default."""
    import rclpy
    from rclpy.context import Context
    from rclpy.parameter import Parameter

    from flowbothd_common.ros import diagnostics, liveness
    from flowbothd_perception import perception_node

    class Clock:
        now = BEGIN

        def monotonic(self):
            return self.now

    clock = Clock()
    for module in (liveness, diagnostics, perception_node):
        monkeypatch.setattr(module, "time", clock)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    context = Context()
    rclpy.init(context=context, domain_id=71)
    parameters = [Parameter(name, value=value) for name, value in PARAMETERS.items()]
    node = perception_node.PerceptionNode(context=context, parameter_overrides=parameters)
    yield Line(node, clock)
    node.destroy_node()
    rclpy.shutdown(context=context)


def test_a_camera_that_stalls_for_two_seconds_is_missed_and_comes_back(line):
    line.describe()
    line.run(1.0, frames=True)
    before = len(line.clouds)
    assert before == 10, "every frame before the stall"
    assert line.said[-1][1:3] == (OK, "publishing object_cloud")
    stall = line.clock.now
    line.run(2.0, frames=False)
    assert len(line.clouds) == before, "nothing is made up while the camera is silent"
    complaints = [(at, text) for at, level, text, _ in line.said if at > stall and level == ERROR]
    assert complaints[0][1] == "missing: depth/image_raw, depth/camera_info"
    assert 1.5 <= complaints[0][0] - stall <= 1.71, "image_timeout, and a tick of the timer"
    line.run(1.2, frames=True)
    after = line.clouds[before:]
    assert len(after) == 12, "every frame after it"
    assert [made == pytest.approx(stamp) for made, stamp in after], "each with its own stamp"
    assert line.said[-1][1:3] == (OK, "publishing object_cloud")
    figures = line.said[-1][3]
    assert figures["frames dropped"] == "0"
    recovered = next(at for at, level, *_ in line.said if at > stall + 2.0 and level == OK)
    assert recovered - stall - 2.0 <= 0.11


def test_frames_that_come_late_all_at_once_keep_their_stamps(line):
    """A driver may hold back what it took during a stall: joint states of these times are kept."""
    line.describe()
    line.run(1.0, frames=True)
    begin, before = line.clock.now, len(line.clouds)
    line.run(2.0, frames=False)
    late = [round(begin + k / 10, 3) for k in range(1, 21)]
    for stamp in late:
        line.frame(stamp)
    assert [stamp for _, stamp in line.clouds[before:]] == late


def test_frames_during_a_stall_of_the_joint_states_are_dropped_and_said(line):
    """The other way round: the camera goes on, the arm says nothing for two seconds."""
    line.describe()
    line.run(1.0, frames=True)
    before, quiet = len(line.clouds), line.clock.now
    for k in range(1, 21):
        line.clock.now = quiet + k / 10
        line.frame(line.clock.now)
        for timer in line.timers:
            timer.callback()
    assert len(line.clouds) == before, "no frame passes as if the arm were where it was"
    assert "missing: joint_states" in line.said[-1][2]
    assert line.said[-1][1] == ERROR
    assert int(line.said[-1][3]["frames dropped"]) >= 10
