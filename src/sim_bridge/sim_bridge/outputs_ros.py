"""Publishers of the bridge and their rates."""

from __future__ import annotations

import time
from collections.abc import Generator

from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, JointState, PointCloud2
from std_msgs.msg import Header

from flowbothd_common.ros import qos
from flowbothd_common.ros.conversions import to_stamp, to_wrench
from flowbothd_interfaces.msg import SimState, SuctionMeasurement
from sim_bridge.camera import DepthImage
from sim_bridge.messages_ros import CameraMessages
from sim_bridge.params import BridgeParams
from sim_bridge.session import Session

_EXPOSURE_BUDGET = 0.006
"""Most time at once that is spent on a picture [s]."""


class BridgeOutputs:
    """Publishers of the bridge: call `publish` after every tick, `expose` as often as possible."""

    def __init__(self, node: Node, params: BridgeParams) -> None:
        self._params = params
        self._messages = CameraMessages(params.camera.intrinsics)
        self._exposure: Generator[None, None, DepthImage] | None = None
        self._exposed = Header()
        make = node.create_publisher
        self._clock = make(Clock, "/clock", qos.STATE)
        self._joints = make(JointState, "joint_states", qos.STATE)
        self._wrench = make(WrenchStamped, "external_wrench", qos.STATE)
        self._suction = make(SuctionMeasurement, "suction/measurement", qos.STATE)
        self._state = make(SimState, "sim/state", qos.STATE)
        self._image = make(Image, "depth/image_raw", qos.IMAGE)
        self._info = make(CameraInfo, "depth/camera_info", qos.IMAGE)
        self._cloud = make(PointCloud2, "points2", qos.IMAGE)

    def restart(self) -> None:
        """Drop the picture that is being taken: the world it shows is gone."""
        self._exposure = None

    def publish(self, session: Session, vacuum: float, factor: float, *, holding: bool) -> None:
        """Publish everything that is due at this tick.

        Args:
            session: World and camera.
            vacuum: Commanded set-point of the pump [Pa].
            factor: Real-time factor.
            holding: The arm holds because no commands arrive.
        """
        params = self._params
        step = params.arm.time_step
        tick = round(session.world.time / step)

        def due(rate: float) -> bool:
            return tick % max(1, round(1.0 / (step * rate))) == 0

        header = Header(stamp=to_stamp(session.time), frame_id=params.base_frame)
        if due(params.joint_state_rate):
            self._clock.publish(Clock(clock=header.stamp))
            self._joints.publish(_joint_state(session, header))
            wrench = to_wrench(session.world.wrench())
            self._wrench.publish(WrenchStamped(header=header, wrench=wrench))
        if due(params.suction_rate):
            self._suction.publish(_measurement(session, header, vacuum))
        if due(params.state_rate):
            self._state.publish(_state(session, header, factor, holding=holding))
        if due(params.camera.rate) and self._exposure is None:
            self._exposed = Header(stamp=header.stamp, frame_id=params.camera.frame)
            self._exposure = session.camera.exposing(session.world.part_poses())

    def expose(self) -> None:
        """Work on the picture that is being taken, but not for long: the arm must not stutter."""
        end = time.monotonic() + _EXPOSURE_BUDGET
        while self._exposure is not None and time.monotonic() < end:
            try:
                next(self._exposure)
            except StopIteration as done:
                self._exposure = None
                self._publish_image(done.value)

    def _publish_image(self, image: DepthImage) -> None:
        header = self._exposed
        self._image.publish(self._messages.image(header, image.millimetres()))
        self._info.publish(self._messages.info(header))
        if self._cloud.get_subscription_count():
            self._cloud.publish(self._messages.cloud(header, image.depth))


def _joint_state(session: Session, header: Header) -> JointState:
    positions, velocities = session.world.joint_state()
    return JointState(
        header=header,
        name=list(session.world.joint_names),
        position=positions.tolist(),
        velocity=velocities.tolist(),
    )


def _measurement(session: Session, header: Header, vacuum: float) -> SuctionMeasurement:
    reading = session.world.suction()
    return SuctionMeasurement(
        header=header,
        vacuum=reading.vacuum,
        in_control_range=0 < 0.9 * vacuum <= reading.vacuum,
        part_present=reading.part_present,
        part_detached=reading.part_detached,
        fault=bool(reading.fault),
        fault_message=reading.fault,
    )


def _state(session: Session, header: Header, factor: float, *, holding: bool) -> SimState:
    world = session.world
    ratios = world.open_ratios()
    return SimState(
        header=header,
        object=world.model.name,
        mode=world.model.mode,
        seed=session.setup.seed,
        joint_names=list(ratios),
        positions=list(world.object_positions().values()),
        open_ratios=list(ratios.values()),
        target_joint=world.model.target_joint,
        open_ratio=ratios[world.model.target_joint],
        attached=world.cup.attached,
        real_time_factor=factor,
        holding=holding,
    )
