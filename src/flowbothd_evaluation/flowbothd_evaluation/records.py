"""What is kept of every trial and run of the experiments: one record each, typed.

`record_files` writes and reads them as lines of JSON. Names and types of the fields are the format:
whoever changes them raises the version there and converts what was written before.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import ClassVar

from flowbothd_common.types import Outcome

TRUTH, NONE = MASKS = ("truth", "none")
"""Which points may be grasped: those of the target link, or of the whole cloud."""


@dataclass(frozen=True)
class Seconds:
    """Durations; 0 where nothing was measured.

    Attributes:
        wall: Of the whole trial, on the wall clock [s].
        simulated: The same on the clock of the world [s].
        predicting: Wall time in the predictor [s].
        world: Wall time in the simulation [s].
    """

    wall: float = 0.0
    simulated: float = 0.0
    predicting: float = 0.0
    world: float = 0.0


@dataclass(frozen=True)
class PullSignals:
    """What the policy noticed and did, by column: one entry a pull.

    Attributes:
        open_ratio: After the pull.
        history_updated: The pull's prediction was remembered.
        grasp_switched: The pull was made from a new grasp point, with the part already moved.
        consistency_trials: Samples rejected before the one that was executed.
        cosine: Of the sample that was acted upon with the truth; None where nothing moves.
        mean_error: Mean distance of its vectors from the true ones, likewise.
        rmse: Root of their mean square, likewise.
    """

    open_ratio: tuple[float | None, ...] = ()
    history_updated: tuple[bool, ...] = ()
    grasp_switched: tuple[bool, ...] = ()
    consistency_trials: tuple[int, ...] = ()
    cosine: tuple[float | None, ...] = ()
    mean_error: tuple[float | None, ...] = ()
    rmse: tuple[float | None, ...] = ()


@dataclass(frozen=True, kw_only=True)
class TrialRecord:
    """The part that trials of all experiments have in common.

    Attributes:
        object: Name of the object or scene.
        method: Predictor, by the name that the experiment has for it.
        seed: Of the trial.
        outcome: The policy's word, corrected by the joint where an experiment does that.
        reason: For people.
        success: The target joint is more than 0.9 open.
        open_ratio: Of the target joint at the end, 0 closed to 1 open.
        steps: Pulls.
        grasps: Contacts.
        seconds: Durations.
    """

    object: str
    method: str
    seed: int
    outcome: Outcome
    reason: str
    success: bool
    open_ratio: float
    steps: int
    grasps: int
    seconds: Seconds


@dataclass(frozen=True, kw_only=True)
class PaperRecord(TrialRecord):
    """One trial of `flowbothd eval paper`.

    Attributes:
        category: Of the object, as the paper spells it.
        link: That was to be opened; without a target the one that opened most.
        joint: Its joint; empty if nothing was simulated.
        target_mask: One of MASKS.
        trial: Number of the repetition.
        switches: Parts of the policy that were on, joined by +.
        policy: paper or robot.
        weights: Name or path; empty for methods without.
        weights_sha256: First digits of the hash of the file; weights trained again have another.
        max_steps: Pulls at most.
        base_seed: Of the whole evaluation.
        normalized_distance: 1 - open ratio, as in the paper's second table.
        per_step: Signals of the pulls.
    """

    KIND: ClassVar[str] = "paper"

    category: str
    link: str
    joint: str
    target_mask: str
    trial: int
    switches: str
    policy: str
    weights: str
    weights_sha256: str
    max_steps: int
    base_seed: int
    normalized_distance: float
    per_step: PullSignals

    @property
    def target(self) -> str:
        """The link that was asked for; empty without a target, where the link is an outcome."""
        return self.link if self.target_mask == TRUTH else ""

    @property
    def key(self) -> Hashable:
        """By which the record of a trial is found again."""
        return (
            *(self.object, self.target, self.trial, self.method, self.switches, self.policy),
            *(self.weights, self.weights_sha256, self.max_steps, self.base_seed),
        )


@dataclass(frozen=True, kw_only=True)
class ArmRecord(TrialRecord):
    """One trial of `flowbothd eval arm`.

    Attributes:
        suite: Part of the table that it belongs to.
        world: arm or floating.
        mode: That was asked for, of an object with modes; else empty.
        target: Joint that was asked for; empty = the object's own.
        predictor: Identifies the predictor and its weights.
        open_ratio_left: Open ratio after the arm has gone.
        resamples: Predictions that were rejected.
        peak_force: Largest force on the tool [N].
        contacts: Largest force of every contact of the arm but the cup's, by "link - thing" [N].
    """

    KIND: ClassVar[str] = "arm"

    suite: str
    world: str
    mode: str
    target: str
    predictor: str = ""
    open_ratio_left: float = 0.0
    resamples: int = 0
    peak_force: float = 0.0
    contacts: dict[str, float]

    @property
    def key(self) -> tuple[str, str, str, str, str, str, int]:
        """By which the record of a trial is found again, and records are sorted."""
        place = (self.suite, self.world, self.object, self.mode, self.target)
        return (*place, self.method, self.seed)


@dataclass(frozen=True)
class Touch:
    """A contact of the arm that was not the cup's on the part.

    Attributes:
        link: Of the robot.
        thing: Link of the object, table, or another link of the robot.
        phase: In which part of the run it was hardest.
        time: When it began [s].
        peak: Largest force [N]; 0 for the arm on itself, which the physics does not know.
    """

    link: str
    thing: str
    phase: str
    time: float
    peak: float


@dataclass(frozen=True, kw_only=True)
class OpeningRecord:
    """One run of `flowbothd eval openings`.

    Attributes:
        task: Name of the opening.
        seed: Of the run.
        at: Position (x, y), yaw of the object and grasp (2) [m, rad]: another pose is another run.
        reached: Joint value when the cup last held [rad or m].
        left: Joint value at the end [rad or m].
        opened: It reached what was wanted.
        clean: No break of suction and no touch.
        suction_breaks: Why the part came off, each time.
        touches: Contacts that were not the cup's.
        peak_force: Largest force on the tool, by phase [N].
        peak_torque: The same of torque [Nm].
        reasons: End of every motion, in order.
        grasp_error: (2,) error of the grasp point on the part's face [m].
        planning_ms: Thread time of every plan, by kind of motion [ms].
        seconds: Durations.
    """

    KIND: ClassVar[str] = "opening"

    task: str
    seed: int
    at: tuple[float, ...]
    reached: float
    left: float
    opened: bool
    clean: bool
    suction_breaks: tuple[str, ...]
    touches: tuple[Touch, ...]
    peak_force: dict[str, float]
    peak_torque: dict[str, float]
    reasons: tuple[str, ...]
    grasp_error: tuple[float, ...]
    planning_ms: dict[str, tuple[float, ...]]
    seconds: Seconds

    @property
    def key(self) -> Hashable:
        """By which the record of a run is found again."""
        return self.task, self.seed, self.at
