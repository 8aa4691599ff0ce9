"""Records of runs: summaries, signals per step, moments for pictures."""

import json

import numpy as np
import pytest

from flowbothd_common.motion import MotionKind, MotionReason
from flowbothd_evaluation.record_files import RecordError, write_json
from flowbothd_evaluation.run_record.record import (
    MotionEntry,
    PredictionSample,
    RunRecord,
    StateSample,
    load_record,
    save_record,
)
from flowbothd_evaluation.run_record.signals import plot_signals, step_signals
from flowbothd_policy.commands import Decision


def decision(time, step, decision="observe", grasps=1, trials=0, **changes):
    return Decision(
        0, time, "waiting", "motion_result", decision, "", step, grasps, trials, **changes
    )


def motion(peak_force):
    return MotionEntry(
        time=1.0,
        motion=MotionKind.FLOW_STEP,
        reason=MotionReason.REACHED,
        message="",
        reached_fraction=1.0,
        tool_motion=np.array([0.05, 0.0, 0.0]),
        contact=True,
        vacuum=True,
        peak_force=peak_force,
        max_lag=0.01,
        duration=0.5,
    )


def a_record() -> RunRecord:
    record = RunRecord("custom_door", "pull_left", 3, "ambiguous")
    record.states = [StateSample(float(t), np.zeros(7), {}, 0.25 * t) for t in range(5)]
    record.decisions = [
        decision(0.5, 0, decision="resample", trials=1),
        decision(0.6, 0, decision="resample", trials=2),
        decision(1.0, 1, history_updated=True),
        decision(2.0, 2),
        decision(2.5, 2, decision="switch", grasp_switched=True, grasps=2),
        decision(3.0, 3, grasps=2, history_updated=True),
        decision(4.0, 3, grasps=2, outcome="opened", decision="finish"),
    ]
    record.motions = [motion(12.34), motion(3.0)]
    return record


def test_the_summary_holds_what_the_demo_promises():
    summary = a_record().summary()
    assert summary.success is True and summary.open_ratio == 1.0
    assert (summary.steps, summary.grasps, summary.resamples) == (3, 2, 2)
    assert summary.peak_force == 12.3 and summary.sim_s == 4.0
    assert summary.outcome == "opened"


def test_a_run_without_an_outcome_is_no_success():
    record = RunRecord("custom_door", "", 0, "oracle")
    assert record.summary().success is False
    assert record.summary().outcome == "not_opened"


def test_open_means_more_than_nine_tenths():
    record = a_record()
    record.states[-1] = StateSample(4.0, np.zeros(7), {}, 0.9)
    assert record.summary().success is False


def test_signals_belong_to_the_step_in_which_they_happened(tmp_path):
    signals = step_signals(a_record())
    assert [s.trials for s in signals] == [2, 0, 0]
    assert [s.history_updated for s in signals] == [True, False, True]
    assert [s.grasp_switched for s in signals] == [False, False, True]
    assert [s.open_ratio for s in signals] == [0.25, 0.5, 0.75]
    plot_signals(a_record(), tmp_path / "signals.png")
    assert (tmp_path / "signals.png").stat().st_size > 5000


def test_success_is_judged_when_the_policy_is_done_and_what_is_left_is_told_too():
    """A lid falls shut once it is let go; that it was open is no less true."""
    record = a_record()
    record.decisions[-1] = decision(4.0, 3, decision="end")
    record.decisions.append(decision(9.0, 3, decision="finish", outcome="opened"))
    record.states.append(StateSample(9.0, np.zeros(7), {}, 0.1))
    summary = record.summary()
    assert summary.success is True and summary.open_ratio == 1.0
    assert summary.open_ratio_left == 0.1


def test_a_record_survives_saving(tmp_path):
    record = a_record()
    rng = np.random.default_rng(0)
    points = rng.normal(size=(5, 3)).astype(np.float32)
    record.predictions = [PredictionSample(1.5, points, points[None])]
    save_record(record, tmp_path)
    again = load_record(tmp_path)
    assert again.summary() == record.summary()
    assert [d.decision for d in again.decisions] == [d.decision for d in record.decisions]
    np.testing.assert_array_equal(again.decisions[0].flow, record.decisions[0].flow)
    np.testing.assert_array_equal(again.motions[0].tool_motion, record.motions[0].tool_motion)
    assert again.motions[0].motion is MotionKind.FLOW_STEP
    np.testing.assert_array_equal(again.predictions[0].flows, record.predictions[0].flows)
    assert again.states[2].open_ratio == record.states[2].open_ratio


def test_a_record_from_before_versions_is_read(tmp_path):
    """It held its summary, and of a graph that failed a decision of three words."""
    record = a_record()
    save_record(record, tmp_path)
    file = tmp_path / "record.json"
    plain = json.loads(file.read_text())
    for name in ("record", "version", "predictions"):
        del plain[name]
    plain["summary"] = {"success": True}
    plain["decisions"].append({"outcome": "error", "reason": "no nodes", "decision": "abort"})
    file.write_text(json.dumps(plain))
    again = load_record(tmp_path)
    assert again.states[2].open_ratio == record.states[2].open_ratio
    assert again.summary().outcome == "error" and again.decisions[-1].step == 0


def test_half_a_record_is_an_error_that_says_what_is_missing(tmp_path):
    save_record(a_record(), tmp_path)
    file = tmp_path / "record.json"
    plain = json.loads(file.read_text())
    del plain["motions"][1]["max_lag"]
    file.write_text(json.dumps(plain))
    with pytest.raises(RecordError, match=r"record\.json.*motions\.1\.max_lag"):
        load_record(tmp_path)


def test_json_is_written_whole_or_not_at_all(tmp_path):
    path = tmp_path / "summary.json"
    write_json(path, {"array": np.arange(3), "flag": np.bool_(True)})
    assert json.loads(path.read_text()) == {"array": [0, 1, 2], "flag": True}
    assert [p.name for p in tmp_path.iterdir()] == ["summary.json"]
