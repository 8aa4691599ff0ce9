"""The policy's state machine: every phase against every event, and the rules in between."""

from dataclasses import replace

import numpy as np
import pytest

from flowbothd_common.motion import MotionKind, MotionReason, MotionResult
from flowbothd_common.transforms import rotation_from_rpy, transform
from flowbothd_common.types import Outcome, SuctionPhase
from flowbothd_policy.commands import (
    Decision,
    Finish,
    Move,
    Predict,
    SetSuction,
    StopMotion,
)
from flowbothd_policy.events import (
    CloudArrived,
    InputsBack,
    InputsLost,
    MotionFinished,
    OperatorStop,
    PredictionArrived,
    PredictionFailed,
    Start,
    SuctionChanged,
    WaitExpired,
)
from flowbothd_policy.params import GraspParams, PolicyParams
from flowbothd_policy.state import Phase, PolicyState
from flowbothd_policy.state_machine import advance, waiting
from flowbothd_policy.transitions.selection import sample_seed

PARAMS = PolicyParams(
    grasp=GraspParams(edge_margin=0.0, direction="flow", normal_angle=0.0), compliance=0.0
)
RNG = np.random.default_rng(0)
POINTS = np.column_stack(
    [np.full(64, 0.5), np.linspace(-0.1, 0.1, 64), 0.2 + 0.1 * RNG.random(64)]
).astype(np.float32)


def pulling(direction=(-1, 0, 0), samples=1):
    """Flow that grows towards +y, largest at the last point."""
    ramp = np.linspace(0.1, 1, 64)[:, None]
    return np.tile((ramp * np.asarray(direction)).astype(np.float32), (samples, 1, 1))


def cloud(stamp, count=64):
    return CloudArrived(POINTS[:count], stamp)


def predicted(stamp, direction=(-1, 0, 0), samples=1):
    return PredictionArrived(POINTS, pulling(direction, samples), stamp, "test")


def moved(kind, reason=MotionReason.REACHED, by=(0, 0, 0), vacuum=False, fraction=1.0):
    start = transform(translation=POINTS[-1])
    end = transform(translation=POINTS[-1] + np.asarray(by))
    return MotionFinished(
        MotionResult(kind, reason, "", fraction, start, end, contact=vacuum, vacuum=vacuum)
    )


STOPPED_OUTSIDE = moved(MotionKind.FLOW_STEP, MotionReason.STOPPED, vacuum=True)
STEPPED = moved(MotionKind.FLOW_STEP, by=(-0.05, 0, 0), vacuum=True)
STALLED = moved(MotionKind.FLOW_STEP, MotionReason.STALLED, vacuum=True)
PROBED = moved(MotionKind.PROBE, MotionReason.VACUUM, vacuum=True)


class Player:
    """Feeds events and keeps what came out."""

    def __init__(self, params=PARAMS):
        self.params, self.state, self.now = params, PolicyState(), 0.0
        self.commands = []

    def feed(self, *events):
        for event in events:
            self.now += 1.0
            self.state, self.commands = advance(self.state, event, self.now, self.params)
        return self

    def only(self, kind):
        return [command for command in self.commands if isinstance(command, kind)]

    @property
    def decision(self):
        return self.only(Decision)[-1]

    def see(self, direction=(-1, 0, 0)):
        """Cloud and prediction, from OBSERVING."""
        stamp = self.now + 0.5
        return self.feed(cloud(stamp), predicted(stamp, direction))

    def grasp(self):
        """From OBSERVING to STEPPING."""
        self.see().feed(moved(MotionKind.APPROACH), SuctionChanged(SuctionPhase.BUILDING))
        return self.feed(SuctionChanged(SuctionPhase.HOLDING), PROBED)


def player_in(phase, params=PARAMS):
    player = Player(params)
    if phase is Phase.IDLE:
        return player
    player.feed(Start())
    if phase is Phase.OBSERVING:
        return player
    if phase is Phase.PREDICTING:
        return player.feed(cloud(player.now + 0.5))
    if phase is Phase.APPROACHING:
        return player.see()
    if phase is Phase.PROBING:
        return player.see().feed(moved(MotionKind.APPROACH))
    player.grasp()
    if phase is Phase.STEPPING:
        return player
    if phase is Phase.RELEASING:
        return player.feed(STALLED)
    if phase is Phase.RETREATING:
        return player.feed(STALLED, SuctionChanged(SuctionPhase.OFF))
    if phase is Phase.PAUSED:
        return player.feed(InputsLost(("camera",)))
    return player.feed(OperatorStop("enough"))


EVENTS = {
    "start": Start(),
    "cloud": cloud(1e9),
    "prediction": predicted(1.5),
    "failed": PredictionFailed("out of memory"),
    "approached": moved(MotionKind.APPROACH),
    "probed": PROBED,
    "stepped": STEPPED,
    "retreated": moved(MotionKind.RETREAT),
    "fault": SuctionChanged(SuctionPhase.FAULT, "leak"),
    "off": SuctionChanged(SuctionPhase.OFF),
    "lost": InputsLost(("camera",)),
    "back": InputsBack(),
    "expired": WaitExpired(),
    "stop": OperatorStop("enough"),
}
TABLE = {
    Phase.IDLE: {"start": Phase.OBSERVING},
    Phase.OBSERVING: {
        "cloud": Phase.PREDICTING,
        "fault": Phase.FINISHED,
        "lost": Phase.PAUSED,
        "expired": Phase.FINISHED,
        "stop": Phase.FINISHED,
    },
    Phase.PREDICTING: {
        "prediction": Phase.APPROACHING,
        "failed": Phase.OBSERVING,
        "fault": Phase.FINISHED,
        "lost": Phase.PAUSED,
        "expired": Phase.OBSERVING,
        "stop": Phase.FINISHED,
    },
    Phase.APPROACHING: {
        "approached": Phase.PROBING,
        "fault": Phase.FINISHED,
        "lost": Phase.PAUSED,
        "expired": Phase.FINISHED,
        "stop": Phase.FINISHED,
    },
    Phase.PROBING: {
        "probed": Phase.STEPPING,
        "fault": Phase.FINISHED,
        "lost": Phase.PAUSED,
        "expired": Phase.FINISHED,
        "stop": Phase.FINISHED,
    },
    Phase.STEPPING: {
        "stepped": Phase.OBSERVING,
        "fault": Phase.FINISHED,
        "lost": Phase.PAUSED,
        "expired": Phase.FINISHED,
        "stop": Phase.FINISHED,
    },
    Phase.RELEASING: {
        "off": Phase.RETREATING,
        "fault": Phase.FINISHED,
        "lost": Phase.PAUSED,
        "expired": Phase.RETREATING,
        "stop": Phase.FINISHED,
    },
    Phase.RETREATING: {
        "retreated": Phase.OBSERVING,
        "fault": Phase.FINISHED,
        "lost": Phase.PAUSED,
        "expired": Phase.FINISHED,
        "stop": Phase.FINISHED,
    },
    Phase.PAUSED: {
        "lost": Phase.PAUSED,
        "back": Phase.PAUSED,
        "expired": Phase.FINISHED,
        "stop": Phase.FINISHED,
    },
    Phase.FINISHED: {"start": Phase.OBSERVING},
}


@pytest.mark.parametrize("name", EVENTS)
@pytest.mark.parametrize("phase", list(Phase))
def test_every_phase_with_every_event(phase, name):
    player = player_in(phase)
    assert player.state.phase is phase
    before = player.state
    player.feed(EVENTS[name])
    expected = TABLE[phase].get(name)
    if expected is None:
        assert player.state.phase is phase
        assert player.state.sequence == before.sequence
        assert not player.commands
        return
    assert player.state.phase is expected
    # Whatever leads somewhere is told: one decision, numbered, in the state it led to.
    assert player.decision.sequence == before.sequence or name == "start"
    assert player.decision.state == player.state.phase.value
    assert player.decision.reason
    if expected is Phase.FINISHED:
        assert player.only(Finish)
        assert player.decision.outcome
        if before.pump_on and name != "fault":
            assert SetSuction(0.0) in player.commands
        if phase in (Phase.APPROACHING, Phase.PROBING, Phase.STEPPING, Phase.RETREATING):
            assert StopMotion() in player.commands


@pytest.mark.parametrize("phase", list(Phase))
def test_everything_that_is_waited_for_has_a_limit(phase):
    wait = waiting(player_in(phase).state, PARAMS)
    if phase in (Phase.IDLE, Phase.FINISHED):
        assert wait is None
    else:
        assert wait[0]
        assert 0 < wait[1] < 1000


def test_the_order_of_a_first_step():
    player = Player().feed(Start())
    assert player.state.phase is Phase.OBSERVING
    assert player.state.observe_after == player.now
    stamp = player.now + 0.1
    player.feed(cloud(stamp))
    predict = player.only(Predict)[0]
    assert predict.history is None
    assert predict.seed == sample_seed(PARAMS.seed, 0, 0, 0)
    player.feed(predicted(stamp))
    goal = player.only(Move)[0].goal
    assert goal.kind is MotionKind.APPROACH
    np.testing.assert_allclose(goal.contact, POINTS[-1])
    np.testing.assert_allclose(goal.direction, (-1, 0, 0))
    player.feed(moved(MotionKind.APPROACH))
    assert [type(c) for c in player.commands] == [SetSuction, Move, Decision]
    np.testing.assert_allclose(player.only(Move)[0].goal.direction, (1, 0, 0))
    assert player.state.grasps == 1
    player.feed(PROBED)
    goal = player.only(Move)[0].goal
    assert goal.kind is MotionKind.FLOW_STEP
    assert goal.distance == PARAMS.step_distance
    player.feed(STEPPED)
    assert player.decision.history_updated
    np.testing.assert_allclose(player.decision.tool_motion, (-0.05, 0, 0))
    player.feed(cloud(player.now + 0.1))
    assert player.only(Predict)[0].history is not None


def test_a_tool_in_front_probes_along_the_flow():
    """Motion may come from the near side to push; then the cup touches by going on, not back."""
    player = Player().feed(Start()).see(direction=(1, 0, 0))
    facing = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], dtype=float)
    result = MotionResult(
        MotionKind.APPROACH,
        MotionReason.REACHED,
        reached_fraction=1.0,
        tool_end=transform(facing, (0.4, 0.1, 0.2)),
    )
    player.feed(MotionFinished(result))
    np.testing.assert_allclose(player.only(Move)[0].goal.direction, (1, 0, 0))


def test_old_clouds_and_foreign_predictions_are_ignored():
    player = player_in(Phase.OBSERVING)
    player.feed(cloud(player.state.observe_after))
    assert player.state.phase is Phase.OBSERVING
    player = player_in(Phase.PREDICTING)
    player.feed(predicted(0.123))
    assert player.state.phase is Phase.PREDICTING
    assert not player.commands


def test_an_inconsistent_sample_is_drawn_again_with_another_seed():
    player = player_in(Phase.STEPPING).feed(STEPPED)
    player.feed(cloud(player.now + 0.5))
    first = player.only(Predict)[0]
    player.feed(predicted(first.stamp, direction=(1, 0, 0)))
    second = player.only(Predict)[0]
    assert player.decision.decision == "resample"
    assert "180 deg off" in player.decision.reason
    assert player.decision.trials == 1
    assert second.seed != first.seed
    player.feed(predicted(first.stamp))
    assert player.state.phase is Phase.STEPPING


@pytest.mark.parametrize(("on_exhausted", "angle"), [("last", 180), ("closest", 40)])
def test_after_fifty_rejections_a_sample_is_executed(on_exhausted, angle):
    params = replace(PARAMS, on_exhausted=on_exhausted, samples_per_request=25)
    player = player_in(Phase.STEPPING, params).feed(STEPPED)
    stamp = player.now + 0.5
    player.feed(cloud(stamp))
    player.feed(PredictionArrived(POINTS, fan(40, 25), stamp))
    assert player.state.phase is Phase.PREDICTING
    assert player.state.trials == 25
    player.feed(PredictionArrived(POINTS, fan(180, 25), stamp))
    assert player.state.phase is Phase.STEPPING
    assert player.decision.trials == 50
    pull = player.only(Move)[0].goal.direction
    assert np.degrees(np.arccos(-pull[0])) == pytest.approx(angle, abs=0.1)


def fan(angle, samples):
    direction = (-np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0)
    return pulling(direction, samples)


def test_without_consistency_check_the_first_sample_is_taken():
    player = player_in(Phase.STEPPING, replace(PARAMS, consistency_check=False)).feed(STEPPED)
    player.see(direction=(0, 1, 0))
    assert player.state.phase is Phase.STEPPING
    np.testing.assert_allclose(player.only(Move)[0].goal.direction, (0, 1, 0))


def test_a_refuted_pull_is_not_repeated_until_something_moves():
    player = player_in(Phase.RETREATING).feed(moved(MotionKind.RETREAT)).see()
    assert player.decision.decision == "resample"
    assert "did not move the part" in player.decision.reason
    player.feed(predicted(player.state.observation.stamp, direction=(1, 0, 0)))
    assert player.state.phase is Phase.APPROACHING
    player.feed(moved(MotionKind.APPROACH), PROBED)
    player.feed(moved(MotionKind.FLOW_STEP, by=(0.05, 0, 0), vacuum=True))
    assert player.state.refuted == ()


def test_the_paper_repeats_itself():
    params = replace(PARAMS, reject_failed_directions=False)
    player = player_in(Phase.RETREATING, params).feed(moved(MotionKind.RETREAT)).see()
    assert player.state.phase is Phase.APPROACHING


def test_a_stall_after_the_part_has_moved_refutes_nothing():
    """The end of the joint must not be taken for a wrong direction."""
    player = player_in(Phase.STEPPING).feed(STEPPED).see().feed(STALLED)
    assert player.state.phase is Phase.RELEASING
    assert player.state.refuted == ()


def test_two_late_stalls_are_the_end_of_the_joint():
    player = player_in(Phase.STEPPING)
    for _ in range(3):
        player.feed(STEPPED).see()
    player.feed(STALLED)
    assert player.state.phase is Phase.OBSERVING, "the first late stall is tried again in place"
    player.see().feed(STALLED)
    assert player.state.ending[0] is Outcome.OPENED
    player.feed(SuctionChanged(SuctionPhase.OFF), moved(MotionKind.RETREAT))
    assert player.only(Finish)[0].outcome is Outcome.OPENED


def test_an_arm_at_its_end_is_no_stall_of_the_part():
    """The incident: two steps that the arm could not make ended a half-open door as opened."""
    player = player_in(Phase.STEPPING)
    for _ in range(3):
        player.feed(STEPPED).see()
    at_its_end = moved(MotionKind.FLOW_STEP, MotionReason.JOINT_LIMIT, vacuum=True, fraction=0.2)
    # The whole step, its half, its quarter.
    player.feed(at_its_end, at_its_end, at_its_end)
    assert player.state.stalls == 0
    assert player.state.phase is Phase.RELEASING
    assert player.state.refuted == ()


def test_a_door_that_swung_on_by_itself_is_noticed_by_the_turned_surface():
    """The incident: the cup came off, the door swung open, and every later pull was held to fail.

    The tool had felt 26 of the door's 70 degrees, too few for a stall to be the joint's end.
    """
    player = player_in(Phase.STEPPING).feed(
        moved(MotionKind.FLOW_STEP, MotionReason.SUCTION_LOST, by=(-0.03, 0, 0)),
        SuctionChanged(SuctionPhase.OFF),
    )
    player.feed(moved(MotionKind.RETREAT)).grasp()
    turned = transform(rotation_from_rpy((0, np.radians(-60), 0)), POINTS[-1])
    result = MotionResult(
        MotionKind.FLOW_STEP, MotionReason.FORCE_LIMIT, "", 0.2, turned, turned, vacuum=True
    )
    player.feed(MotionFinished(result))
    assert player.state.phase is Phase.OBSERVING, "the first late stall is tried again in place"
    player.see().feed(MotionFinished(result))
    assert player.state.ending[0] is Outcome.OPENED


def test_a_flip_is_a_failed_attempt():
    player = player_in(Phase.STEPPING)
    player.feed(moved(MotionKind.FLOW_STEP, by=(0.03, 0, 0), vacuum=True))
    assert player.state.phase is Phase.RELEASING
    assert player.state.memory.direction is None


def test_losing_the_part_while_looking_is_a_failed_attempt():
    player = player_in(Phase.STEPPING).feed(STEPPED, SuctionChanged(SuctionPhase.LOST, "peeled"))
    assert player.state.phase is Phase.RELEASING
    assert player.state.refuted == ()
    assert player.only(SetSuction) == [SetSuction(0.0)]


def test_the_arm_backs_off_only_when_the_cup_has_vented():
    player = player_in(Phase.RELEASING)
    assert player.only(SetSuction)
    assert not player.only(Move)
    player.feed(SuctionChanged(SuctionPhase.OFF))
    assert player.only(Move)[0].goal.kind is MotionKind.RETREAT


def test_pause_keeps_the_part_and_goes_on():
    player = player_in(Phase.STEPPING).feed(InputsLost(("perception_node", "camera")))
    assert StopMotion() in player.commands
    assert not player.only(SetSuction)
    assert "perception_node, camera" in player.decision.reason
    player.feed(moved(MotionKind.FLOW_STEP, MotionReason.STOPPED, by=(-0.03, 0, 0), vacuum=True))
    assert player.state.phase is Phase.PAUSED
    assert player.state.travel.length == pytest.approx(0.03)
    player.feed(InputsBack())
    assert player.state.phase is Phase.OBSERVING
    assert player.decision.decision == "resume"
    assert player.state.grasps == 1


def test_pause_before_the_part_is_held_starts_over():
    player = player_in(Phase.PROBING).feed(InputsLost(("inference_node",)), InputsBack())
    player.feed(moved(MotionKind.PROBE, MotionReason.STOPPED))
    assert player.only(Move)[0].goal.kind is MotionKind.RETREAT


@pytest.mark.parametrize("answered", [True, False])
def test_no_motion_is_asked_for_while_the_last_one_comes_to_rest(answered):
    """The incident: back after half a second, the retreat was refused: approach still running."""
    player = player_in(Phase.APPROACHING).feed(InputsLost(("camera",)), InputsBack())
    assert player.state.phase is Phase.PAUSED
    assert not player.only(Move)
    assert waiting(player.state, PARAMS) == ("the arm to come to rest", PARAMS.wait.halt)
    stopped = moved(MotionKind.APPROACH, MotionReason.STOPPED, fraction=0.4)
    player.feed(stopped if answered else WaitExpired())
    assert player.decision.decision == "resume"
    assert player.only(Move)[0].goal.kind is MotionKind.RETREAT


def test_a_pause_without_motion_is_over_at_once():
    player = player_in(Phase.PREDICTING).feed(InputsLost(("inference_node",)), InputsBack())
    assert player.state.phase is Phase.OBSERVING


def test_missing_inputs_may_abort():
    params = replace(PARAMS, on_inputs_lost="abort")
    player = player_in(Phase.STEPPING, params).feed(InputsLost(("camera",)))
    assert player.only(Finish)[0].outcome is Outcome.ABORTED
    assert StopMotion() in player.commands


@pytest.mark.parametrize("steps", [0, 3])
def test_an_operator_stop_is_judged_by_the_opening(steps):
    player = player_in(Phase.STEPPING)
    for _ in range(steps):
        player.feed(STEPPED).see()
    player.feed(OperatorStop("that will do"))
    expected = Outcome.OPENED if steps else Outcome.ABORTED
    assert player.only(Finish)[0].outcome is expected
    assert "that will do" in player.only(Finish)[0].reason
    told = player_in(Phase.OBSERVING).feed(OperatorStop("seen", opened=True))
    assert told.only(Finish)[0].outcome is Outcome.OPENED


def test_a_motion_stopped_from_outside_ends_the_run():
    player = player_in(Phase.STEPPING).feed(STOPPED_OUTSIDE)
    assert player.only(Finish)[0].outcome is Outcome.ABORTED


def test_a_refused_motion_is_asked_for_again():
    """The incident: a probe was refused because the arm still moved at 0.07 rad/s."""
    player = player_in(Phase.PROBING)
    refused = moved(MotionKind.PROBE, MotionReason.REJECTED, fraction=0.0)
    for _ in range(PARAMS.max_refusals - 1):
        player.feed(refused)
        assert player.state.phase is Phase.PROBING
        assert waiting(player.state, PARAMS)[1] == PARAMS.wait.refusal
        player.feed(WaitExpired())
        assert player.only(Move)[0].goal.kind is MotionKind.PROBE
        assert waiting(player.state, PARAMS)[1] == PARAMS.wait.motion
    player.feed(refused)
    assert player.only(Finish)[0].outcome is Outcome.ERROR
    assert f"refused {PARAMS.max_refusals} times" in player.only(Finish)[0].reason


def test_refusals_are_counted_in_a_row():
    player = player_in(Phase.PROBING)
    player.feed(moved(MotionKind.PROBE, MotionReason.REJECTED), WaitExpired(), PROBED)
    assert player.state.phase is Phase.STEPPING
    assert player.state.refusals == 0


def test_stale_inputs_are_no_failed_attempt_but_bounded():
    player = player_in(Phase.STEPPING)
    stale = moved(MotionKind.FLOW_STEP, MotionReason.STALE_INPUT, vacuum=True)
    for _ in range(PARAMS.max_interruptions):
        player.feed(stale)
        assert player.decision.decision == "recover"
        assert player.state.phase is Phase.OBSERVING
        player.see()
    player.feed(stale)
    assert player.state.ending[0] is Outcome.ABORTED


def test_a_held_arm_costs_another_look_and_says_nothing_of_the_part():
    """The incident: a heartbeat came late, the arm was held, and the pull was held to be wrong."""
    player = player_in(Phase.STEPPING)
    lagging = moved(MotionKind.FLOW_STEP, MotionReason.LAGGING, by=(-0.005, 0, 0), vacuum=True)
    player.feed(lagging)
    assert player.state.phase is Phase.OBSERVING
    assert player.state.refuted == player.state.avoided == ()
    assert player.state.stalls == 0
    player.see().feed(STEPPED)
    assert player.state.interruptions == 0, "a part that moved is progress"


def test_a_way_home_that_is_cut_short_again_and_again_ends_the_run():
    """The incident: with frozen joint states the run never came to its end."""
    player = player_in(Phase.PROBING)
    lagging = moved(MotionKind.RETREAT, MotionReason.LAGGING)
    player.feed(moved(MotionKind.PROBE, MotionReason.LAGGING), SuctionChanged(SuctionPhase.OFF))
    for _ in range(PARAMS.max_interruptions + 1):
        assert player.state.phase is Phase.RETREATING
        player.feed(lagging)
    assert player.only(Finish)[0].outcome is Outcome.ABORTED
    assert "interrupted" in player.only(Finish)[0].reason


def test_predictions_that_keep_failing_are_an_error():
    player = player_in(Phase.OBSERVING)
    for _ in range(PARAMS.max_prediction_failures):
        player.feed(cloud(player.now + 0.5), PredictionFailed("weights are missing"))
    assert player.only(Finish)[0].outcome is Outcome.ERROR
    assert "3 times: weights are missing" in player.only(Finish)[0].reason


@pytest.mark.parametrize("count", [0, 5])
def test_an_object_out_of_view_is_said_so(count):
    player = player_in(Phase.OBSERVING).feed(cloud(1e9, count))
    assert player.decision.decision == "wait"
    player.feed(cloud(1e9, count), WaitExpired())
    assert player.only(Finish)[0].outcome is Outcome.NOT_VISIBLE
    assert f"{count} points, of 32 needed" in player.only(Finish)[0].reason


def test_nothing_predicted_to_move_is_not_visible():
    params = replace(PARAMS, max_resamples=2)
    player = player_in(Phase.PREDICTING, params)
    still = PredictionArrived(POINTS, 0 * pulling(), player.state.observation.stamp)
    player.feed(still)
    assert player.decision.decision == "resample"
    player.feed(still)
    assert player.only(Finish)[0].outcome is Outcome.NOT_VISIBLE


def test_a_retreat_that_fails_is_tried_again_then_told():
    player = player_in(Phase.RETREATING)
    blocked = moved(MotionKind.RETREAT, MotionReason.COLLISION)
    player.feed(blocked, blocked)
    assert player.state.phase is Phase.RETREATING
    player.feed(blocked)
    assert player.only(Finish)[0].outcome is Outcome.ERROR
    assert "did not get back" in player.only(Finish)[0].reason


def test_the_switch_test_sees_through_the_arm():
    """The arm hides what it holds; the nearest visible point then belongs to something else."""
    params = replace(PARAMS, grasp=GraspParams(edge_margin=0.0, direction="flow", normal_angle=0.0))
    rng = np.random.default_rng(0)
    leaf = np.column_stack(
        [np.full(400, 0.5), rng.uniform(-0.1, 0.1, 400), rng.uniform(0, 0.4, 400)]
    ).astype(np.float32)
    frame = leaf[:60] + np.float32([-0.03, 0, 0])
    visible = np.linalg.norm(leaf - np.float32([0.5, 0.08, 0.2]), axis=1) > 0.08
    points = np.concatenate([leaf[visible], frame])
    flow = np.cross((0, 0, 1.0), points - (0.5, -0.1, 0)).astype(np.float32)
    flow[-60:] = 0
    flow /= np.linalg.norm(flow, axis=1).max()
    for from_screw, decision in ((True, "step"), (False, "switch")):
        p = replace(params, occluded_leverage_from_screw=from_screw, consistency_check=False)
        player = player_in(Phase.STEPPING, p)
        end = transform(translation=(0.5, 0.08, 0.2))
        start = transform(translation=(0.55, 0.08, 0.2))
        result = MotionResult(
            MotionKind.FLOW_STEP, MotionReason.REACHED, "", 1.0, start, end, vacuum=True
        )
        player.feed(
            MotionFinished(replace(result, tool_start=transform(translation=(0.55, 0.08, 0.2))))
        )
        stamp = player.now + 0.5
        player.feed(CloudArrived(points, stamp), PredictionArrived(points, flow[None], stamp))
        assert player.decision.decision == decision, player.decision.reason


def test_seeds_depend_on_every_part():
    seeds = {sample_seed(*parts) for parts in np.ndindex(3, 3, 3, 3)}
    assert len(seeds) == 81
    assert all(0 <= seed < 2**64 for seed in seeds)
    assert sample_seed(1, 2, 3, 4) == 5757640408911466129 or isinstance(
        sample_seed(1, 2, 3, 4), int
    )


def test_a_step_that_the_arm_cannot_make_is_halved_then_given_up():
    """The incident: the arm could follow a lid for 1 of 5 cm, and let it fall shut instead."""
    player = player_in(Phase.STEPPING)
    blocked = moved(MotionKind.FLOW_STEP, MotionReason.SINGULARITY, fraction=0.0)
    for expected in (0.025, 0.0125):
        player.feed(blocked)
        assert player.only(Move)[0].goal.distance == pytest.approx(expected)
        assert player.state.step == 0, "a step that was not made is not counted"
    player.feed(blocked)
    assert player.state.phase is Phase.RELEASING
    assert player.state.refuted == ()
    assert len(player.state.avoided) == 1


def test_after_half_a_step_whole_steps_are_made_again():
    player = player_in(Phase.STEPPING)
    player.feed(moved(MotionKind.FLOW_STEP, MotionReason.JOINT_LIMIT, fraction=0.0), STEPPED).see()
    assert player.only(Move)[0].goal.distance == PARAMS.step_distance


def test_a_late_interruption_is_no_stall():
    """The incident: a step cut short by a busy machine was taken for the end of the joint."""
    player = player_in(Phase.STEPPING)
    for _ in range(3):
        player.feed(STEPPED).see()
    assert player.feed(STALLED).state.stalls == 1
    player.see().feed(moved(MotionKind.FLOW_STEP, MotionReason.STALE_INPUT, vacuum=True))
    assert player.state.stalls == 1
    assert player.state.ending is None


def test_one_lost_cup_does_not_refute_a_direction():
    """The incident: the cup peeled off the right pull, which was then never tried again."""
    player = player_in(Phase.STEPPING)
    lost = moved(MotionKind.FLOW_STEP, MotionReason.SUCTION_LOST, by=(-0.005, 0, 0))
    params = replace(PARAMS, compliance=0.015)
    player.params = params
    for count in (0, 1):
        player.feed(lost)
        assert len(player.state.refuted) == count
        assert len(player.state.avoided) == count + 1
        player.feed(SuctionChanged(SuctionPhase.OFF), moved(MotionKind.RETREAT)).grasp()
        if count == 0:
            assert player.state.phase is Phase.STEPPING
