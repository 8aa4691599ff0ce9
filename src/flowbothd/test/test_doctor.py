"""The doctor's judgement of what it finds."""

from __future__ import annotations

import numpy as np
import pytest

from flowbothd.doctor.doctor_checks import (
    Check,
    Heard,
    Light,
    as_text,
    judge_calibration,
    judge_end_effector,
    judge_nodes,
    judge_pump,
    judge_rate,
    judge_stamps,
    judge_wrench,
)
from flowbothd.doctor.doctor_host import check_host
from flowbothd_bringup.robot_graph import NODES

CAMERA = {"camera.position": [0.6, -1.0, 0.6], "camera.quaternion": [0.0, 0.0, 0.0, 1.0]}


class TestDoctor:
    """Report of the doctor on its findings."""

    def test_rates_and_stamps(self) -> None:
        steady = Heard([0.1 * k for k in range(20)], [0.02] * 20)
        assert steady.rate == pytest.approx(10.0)
        assert judge_rate("camera", steady, 5.0, "mend").light is Light.GREEN
        assert judge_rate("camera", steady, 30.0, "mend").light is Light.YELLOW
        assert judge_rate("camera", Heard(), 5.0, "start it") == Check(
            "camera", Light.RED, "nothing came", "start it"
        )
        assert judge_stamps("camera", steady).light is Light.GREEN
        late = judge_stamps("camera", Heard([0.0], [37.0]))
        assert late.light is Light.RED
        assert "synchronise" in late.remedy
        assert judge_stamps("camera", Heard([0.0], [-3.0])).light is Light.RED

    def test_the_end_effector_of_desk_must_be_ours(self) -> None:
        """The trap: Desk still has the hand's end effector, 57 mm from the cup's tip."""
        ours = np.array([0.4, 0.0, 0.4])
        assert judge_end_effector(ours, ours + 0.001).light is Light.GREEN
        wrong = judge_end_effector(ours, ours + np.array([0, 0, 0.057]))
        assert wrong.light is Light.RED
        assert "57 mm" in wrong.found
        assert "Desk" in wrong.remedy
        assert judge_end_effector(None, ours).light is Light.YELLOW

    def test_wrench_pump_and_nodes(self) -> None:
        assert judge_wrench("wrench", []).light is Light.RED
        assert "tare" in judge_wrench("wrench", [9.0]).remedy
        assert judge_wrench("wrench", [0.5]).light is Light.GREEN
        broken = judge_wrench("wrench", [0.5, float("nan"), 0.5])
        assert broken.light is Light.RED
        assert "1 of 3" in broken.found
        assert judge_pump(Heard(), "").light is Light.RED
        assert judge_pump(Heard([0.0, 0.1]), "no link").found == "no link"
        checks = judge_nodes(["a", "b", "c"], {"a": (True, "fine"), "b": (False, "no camera")})
        assert [check.light for check in checks] == [Light.GREEN, Light.RED, Light.RED]
        assert checks[1].found == "no camera"

    def test_calibration(self) -> None:
        good = {"perception_node": dict(CAMERA)}
        assert judge_calibration(good, []).light is Light.GREEN
        assert judge_calibration(good, ["arm_node x"]).light is Light.RED
        bad = {"perception_node": CAMERA | {"camera.quaternion": [1.0, 1.0, 0.0, 0.0]}}
        assert "length 1.414" in judge_calibration(bad, []).found

    def test_every_red_line_has_a_remedy(self) -> None:
        checks = check_host("panda", "") + judge_nodes(list(NODES), {})
        text = as_text(checks, colour=False)
        assert all(check.remedy for check in checks if check.light is not Light.GREEN)
        assert f"of {len(checks)} are red" in text
        assert "\x1b[31m" in as_text(checks, colour=True)
        assert as_text([Check("x", Light.GREEN, "y")], colour=False).endswith("all is well")
