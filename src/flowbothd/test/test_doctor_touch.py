"""The touch by which the doctor finds out sign and frame of the wrench."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from flowbothd.doctor.doctor_checks import Light, as_text
from flowbothd.doctor.doctor_touch import Felt, WrenchSample, feel, judge_touch, not_asked

BASE = "panda_link0"
NAN = float("nan")


def samples(forces: Sequence[Sequence[float]], frame: str = BASE) -> list[WrenchSample]:
    return [WrenchSample(np.array(force, dtype=float), frame) for force in forces]


def noisy(count: int, offset: Sequence[float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    generator = np.random.default_rng(3)
    return np.array(offset) + generator.normal(scale=0.4, size=(count, 3))


def push(z: float, aside: float = 0.0, offset: Sequence[float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """A touch in the middle of 100 samples, coming and going softly."""
    course = np.clip(np.sin(np.linspace(-np.pi, 2 * np.pi, 100)), 0, None)
    course[:34] = 0.0
    course[67:] = 0.0
    return noisy(100, offset) + np.outer(course, [aside, 0.0, z])


@pytest.mark.parametrize(("z", "felt"), [(8.0, Felt.UP), (-8.0, Felt.DOWN)])
@pytest.mark.parametrize("drift", [-20.0, 0.0, 20.0])
def test_the_direction_is_that_of_the_change(z: float, felt: Felt, drift: float) -> None:
    """An arm whose tool is not tared has an offset larger than any touch."""
    offset = (1.0, -2.0, drift)
    touch = feel(samples(noisy(50, offset)), samples(push(z, offset=offset)))
    assert touch.felt is felt
    assert touch.force == pytest.approx(z, abs=1.0)
    assert touch.frames == (BASE,)


@pytest.mark.parametrize(("z", "sign", "light"), [
    (8.0, 1.0, Light.GREEN),
    (-8.0, -1.0, Light.GREEN),
    (-8.0, 1.0, Light.RED),
    (8.0, -1.0, Light.RED),
])  # fmt: skip
def test_the_sign_must_be_that_of_motion_node(z: float, sign: float, light: Light) -> None:
    """With the sign of franka_ros2 no contact was felt below 42 N, and nothing said so."""
    check = judge_touch(feel(samples(noisy(50)), samples(push(z))), BASE, sign)
    assert check.light is light
    assert f"{z:+.0f}"[0] in check.found
    if light is Light.RED:
        assert f"wrench.sign: {-sign:.1f}" in check.remedy


@pytest.mark.parametrize("frame", ["panda_hand", ""])
def test_another_frame_is_named(frame: str) -> None:
    touch = feel(samples(noisy(50), frame), samples(push(8.0), frame))
    check = judge_touch(touch, BASE, 1.0)
    assert check.light is Light.RED
    assert (frame or "(empty)") in check.found
    assert BASE in check.found
    mixed = feel(samples(noisy(50)), samples(push(8.0), frame))
    assert judge_touch(mixed, BASE, 1.0).light is Light.RED


def test_no_touch_a_touch_aside_and_one_both_ways_are_asked_for_again() -> None:
    for during, felt in (
        (noisy(100), Felt.NOTHING),
        (push(2.0), Felt.NOTHING),
        (push(2.0, aside=9.0), Felt.SIDEWAYS),
        (np.concatenate([push(8.0), push(-8.0)]), Felt.UNCLEAR),
        (noisy(0), Felt.NOTHING),
    ):
        touch = feel(samples(noisy(50)), samples(during))
        assert touch.felt is felt
        check = judge_touch(touch, BASE, 1.0)
        assert check.light is Light.YELLOW
        assert "--touch" in check.remedy
    assert feel([], samples(push(8.0))).felt is Felt.NOTHING


def test_single_spikes_are_no_touch() -> None:
    during = noisy(100)
    during[::20, 2] = -60.0
    assert feel(samples(noisy(50)), samples(during)).felt is Felt.NOTHING


@pytest.mark.parametrize("bad", [[NAN] * 3, [0.0, 0.0, np.inf], [1.0, 2.0]])
def test_samples_that_are_no_numbers_are_counted_and_red(bad: list[float]) -> None:
    """One NaN makes every median, sum and comparison of a plain evaluation meaningless."""
    during = samples(push(8.0))
    during[40] = WrenchSample(np.array(bad), BASE)
    touch = feel(samples(noisy(50)), during)
    assert (touch.felt, touch.unusable) == (Felt.UP, 1)
    assert judge_touch(touch, BASE, 1.0).light is Light.RED
    nothing = feel(samples([[NAN] * 3] * 50), samples([[NAN] * 3] * 50))
    assert (nothing.felt, nothing.unusable) == (Felt.NOTHING, 100)
    check = judge_touch(nothing, BASE, 1.0)
    assert check.light is Light.RED
    assert "100 samples were not finite" in check.found


def test_who_is_not_asked_reads_that_it_was_skipped() -> None:
    text = as_text([not_asked()], colour=False)
    assert "-   wrench by touch: not asked for" in text
    assert "--touch" in text
    assert "all is well" in text


@pytest.mark.ros
class TestHeard:
    """The doctor at the messages of a driver."""

    @pytest.fixture
    def driver(self, monkeypatch: pytest.MonkeyPatch) -> Any:
        pytest.importorskip("rclpy", reason="ROS is not installed")
        import rclpy
        from geometry_msgs.msg import WrenchStamped
        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node

        from flowbothd.doctor.doctor_ear import Ear
        from flowbothd_common.ros import qos

        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        domain = 80
        context = Context()
        rclpy.init(context=context, domain_id=domain)
        node = Node("driver", context=context)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        publisher = node.create_publisher(WrenchStamped, "external_wrench", qos.STATE)
        ear = Ear(domain)

        def play(forces: np.ndarray, frame: str = BASE) -> None:
            queue = iter(forces)

            def speak() -> None:
                force = next(queue, None)
                if force is not None:
                    message = WrenchStamped()
                    message.header.frame_id = frame
                    message.wrench.force.x, message.wrench.force.y, message.wrench.force.z = force
                    publisher.publish(message)

            node.create_timer(0.005, speak)

        spin = ear.spin

        def both(seconds: float) -> None:
            executor.spin_once(timeout_sec=0.0)
            spin(min(seconds, 0.005))

        monkeypatch.setattr(ear, "spin", both)
        yield ear, play
        ear.close()
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown(context=context)

    def until(self, condition: Callable[[], bool], ear: Any) -> None:
        deadline = time.monotonic() + 20.0
        while not condition():
            assert time.monotonic() < deadline, "nothing was heard"
            ear.spin(0.01)

    @pytest.mark.parametrize(("z", "light"), [(9.0, Light.GREEN), (-9.0, Light.RED)])
    def test_a_touch_is_judged_from_what_is_published(
        self, driver: Any, capsys: pytest.CaptureFixture[str], z: float, light: Light
    ) -> None:
        from flowbothd.doctor.doctor import ask_for_touch

        ear, play = driver
        play(np.concatenate([noisy(300), push(z), noisy(400)]))
        self.until(lambda: len(ear.wrenches) >= 100, ear)
        check = ask_for_touch(ear, {"motion_node": {}}, seconds=8.0)
        assert check.light is light, check.found
        assert "Press the cup upwards" in capsys.readouterr().out

    def test_waiting_for_a_touch_ends(self, driver: Any) -> None:
        from flowbothd.doctor.doctor import ask_for_touch

        ear, play = driver
        play(noisy(2000), frame="tool0")
        self.until(lambda: len(ear.wrenches) >= 20, ear)
        began = time.monotonic()
        check = ask_for_touch(ear, {"motion_node": {"robot.base_frame": "fr3_link0"}}, seconds=0.5)
        assert time.monotonic() - began < 5.0
        assert check.light is Light.RED
        assert "'tool0'" in check.found
        assert "fr3_link0" in check.found
