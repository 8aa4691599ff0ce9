"""Parameters of the policy; defaults are the paper's values wherever it names one."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from flowbothd_common.parameters import parameter


@dataclass(frozen=True)
class GraspParams:
    """Choice of a grasp point and a direction from one flow field."""

    edge_margin: float = parameter(
        0.018,
        "distance that the cup's centre should keep from the edge of the part [m]: cup radius "
        "15 mm and 3 mm of play; 0 = the paper's pure arg max",
        minimum=0.0,
        maximum=0.2,
    )
    flatness: float = parameter(
        0.004,
        "largest distance of neighbouring points from their common plane [m]",
        minimum=1e-4,
        maximum=0.1,
    )
    max_tilt: float = parameter(
        math.radians(25.0),
        "largest angle between the flow and the surface normal that the cup seals at [rad]",
        minimum=0.0,
        maximum=math.pi / 2,
    )
    direction: str = parameter(
        "screw",
        "flow: the flow of the chosen point itself, as the paper; screw: that of the rigid motion "
        "fitted to the flow field, where it fits, which averages the noise of single points",
        choices=("flow", "screw"),
    )
    normal_angle: float = parameter(
        math.radians(35.0),
        "the pull is turned onto the normal of a flat place that lies within this angle of it: a "
        "cup holds best along the normal, and a flat part moves along it; 0 = the flow as "
        "predicted, as the paper [rad]",
        minimum=0.0,
        maximum=math.pi / 2,
    )
    normal_tolerance: float = parameter(
        math.radians(12.0),
        "pulls nearer to the normal than this stay as predicted: the normal of a few noisy points "
        "is no better [rad]",
        minimum=0.0,
        maximum=math.pi / 2,
    )
    screw_residual: float = parameter(
        0.2,
        "largest root mean square residual of a rigid motion fitted to max-normalised flow for "
        "the fit to be trusted",
        minimum=0.0,
        maximum=1.0,
    )
    fallback_loss: float = parameter(
        0.5,
        "share of the largest flow norm that may be given up where no place within the leverage "
        "threshold would seal",
        minimum=0.0,
        maximum=1.0,
    )
    table_clearance: float = parameter(
        0.12,
        "height above the table (z = 0 of the base) that places for a horizontal pull should have "
        "[m]: the wrist behind the cup needs that room to turn with the part; lower places are "
        "taken where there are no others, and for vertical pulls; 0 = any, as the paper",
        minimum=0.0,
        maximum=1.0,
    )
    avoid_radius: float = parameter(
        0.02,
        "places nearer than this to one where the cup did not seal are avoided [m]",
        minimum=0.0,
        maximum=0.5,
    )


@dataclass(frozen=True)
class OpeningParams:
    """When the part counts as open, judged by the path of the tool alone."""

    target_angle: float = parameter(
        math.radians(66.0),
        "opening of a hinged part at which the run ends [rad]",
        minimum=0.0,
        maximum=100.0,
    )
    target_distance: float = parameter(
        0.21, "opening of a sliding part at which the run ends [m]", minimum=0.0, maximum=1000.0
    )
    stall_fraction: float = parameter(
        0.5,
        "stalls count as the end of the joint after this fraction of the target",
        minimum=0.0,
        maximum=1.0,
    )
    stalls: int = parameter(
        2, "stalls after that fraction at which the part counts as open", minimum=1, maximum=100
    )
    limit_last_step: bool = parameter(
        True, "shorten the last step so that it ends just past the target"
    )
    path_noise: float = parameter(
        0.002,
        "how far the tool strays from the part's true path [m]; decides when the path shows an "
        "arc from a line",
        minimum=1e-5,
        maximum=0.1,
    )


@dataclass(frozen=True)
class WaitParams:
    """Timeouts of the policy's requests, on the steady clock."""

    observation: float = parameter(10.0, "for a cloud [s]", minimum=0.1, maximum=3600.0)
    prediction: float = parameter(120.0, "for a prediction [s]", minimum=0.1, maximum=3600.0)
    motion: float = parameter(120.0, "for the end of a motion [s]", minimum=0.1, maximum=3600.0)
    release: float = parameter(3.0, "for the pump to vent [s]", minimum=0.0, maximum=60.0)
    refusal: float = parameter(
        0.5, "before a motion that was refused is asked for again [s]", minimum=0.0, maximum=60.0
    )
    halt: float = parameter(
        3.0, "for the arm to come to rest before a paused run goes on [s]", minimum=0.0
    )
    pause: float = parameter(
        60.0, "for missing nodes to come back before the run is aborted [s]", minimum=0.0
    )


@dataclass(frozen=True)
class PolicyParams:
    """Everything that the policy's decisions depend on, apart from what it sees."""

    seed: int = parameter(
        0,
        "run seed; sampling seeds are derived from it, the step and the trial",
        minimum=0,
        maximum=2**62,
    )
    consistency_check: bool = parameter(
        True, "CC: sample again while the flow disagrees with the last measured motion"
    )
    consistency_angle: float = parameter(
        math.radians(30.0),
        "largest angle between flow and last measured motion [rad]",
        minimum=0.0,
        maximum=math.pi,
    )
    max_resamples: int = parameter(
        50, "rejected samples per step after which one is executed anyway", minimum=1, maximum=10000
    )
    on_exhausted: str = parameter(
        "last",
        "which rejected sample is then executed: the last (paper), or the closest to being "
        "accepted",
        choices=("last", "closest"),
    )
    samples_per_request: int = parameter(
        1, "flow fields drawn per request", minimum=1, maximum=1000
    )
    switch_grasp: bool = parameter(
        True, "SG: change the grasp point when another has more leverage"
    )
    leverage: float = parameter(
        0.2,
        "gain of max-normalised flow norm that is worth another grasp; grasp places are also "
        "chosen among points within it of the largest norm",
        minimum=0.0,
        maximum=1.0,
    )
    occlusion_radius: float = parameter(
        0.03,
        "the leverage of the present grasp is read at the visible point nearest to the cup if it "
        "lies within this distance [m], else from the fitted rigid motion",
        minimum=0.0,
    )
    occluded_leverage_from_screw: bool = parameter(
        True, "off: always read the leverage at the nearest visible point, as the paper"
    )
    recontact_consistency: str = parameter(
        "any",
        "what a new contact must be consistent with: the last accepted motion (paper), or any of "
        "the run, because a part that was let go may have fallen back",
        choices=("last", "any"),
    )
    consistency_min_motion: float = parameter(
        0.0,
        "motions up to this are not taken for the direction to be consistent with [m]; the paper's "
        "0 lets the jitter of a failed step decide where nothing else filters it (compliance 0)",
        minimum=0.0,
        maximum=1.0,
    )
    history_filter: bool = parameter(
        True, "HF: remember a prediction only if it moved the part as before"
    )
    history_angle: float = parameter(
        math.pi / 2,
        "largest angle between a motion and the one before for it to be remembered [rad]",
        minimum=0.0,
        maximum=math.pi,
    )
    history_agreement: float = parameter(
        math.radians(60.0),
        "largest angle between the pull and the motion that came of it for the prediction to be "
        "remembered: what moved in spite of a prediction does not speak for it; pi = the paper "
        "[rad]",
        minimum=0.0,
        maximum=math.pi,
    )
    epsilon_m: float = parameter(
        0.01, "tool motion below this is no motion of the part [m]", minimum=0.0, maximum=1.0
    )
    compliance: float = parameter(
        0.015,
        "how far the tool moves by stretching cup and arm alone before a step ends early [m]; "
        "taken off the motion of steps that stalled or lost the part; 0 for rigid grippers",
        minimum=0.0,
        maximum=0.2,
    )
    step_distance: float = parameter(
        0.05, "length of one step along the flow [m]", minimum=0.001, maximum=1.0
    )
    max_steps: int = parameter(30, "flow steps in one run", minimum=1, maximum=100000)
    max_recontacts: int = parameter(
        5, "contacts after the first one, grasp switches included", minimum=0, maximum=100000
    )
    max_unreachable: int = parameter(
        10,
        "grasps that the arm cannot reach at all before the run gives up; they touch nothing and "
        "are no contacts",
        minimum=1,
        maximum=100000,
    )
    reject_failed_directions: bool = parameter(
        True,
        "reject samples that repeat what failed since something last moved, and keep off places "
        "where the cup did not seal; off = the paper",
    )
    failed_radius: float = parameter(
        0.05, "size of the place at which an attempt failed [m]", minimum=0.0, maximum=10.0
    )
    failed_angle: float = parameter(
        math.radians(30.0),
        "flows within this angle of a failed one repeat it [rad]",
        minimum=0.0,
        maximum=math.pi,
    )
    failed_norm: float = parameter(
        0.5,
        "a sample repeats a failed attempt if it gives the place of the attempt at least this "
        "share of its largest flow norm, in the failed direction",
        minimum=0.0,
        maximum=1.0,
    )
    send_joint_estimate: bool = parameter(True, "send motion_node the estimate of the part's joint")
    retreat_first: bool = parameter(False, "go to the start pose before the first look")
    vacuum: float = parameter(
        60000.0, "vacuum asked of the pump [Pa]", minimum=0.0, maximum=100000.0
    )
    min_points: int = parameter(
        32, "clouds with fewer points show no object", minimum=1, maximum=1000000
    )
    max_prediction_failures: int = parameter(
        3, "failed predictions in a row before the run ends", minimum=1, maximum=1000
    )
    max_refusals: int = parameter(
        10, "refusals of one motion in a row before the run ends", minimum=1, maximum=1000
    )
    max_interruptions: int = parameter(
        5,
        "motions cut short by missing inputs or an arm that does not follow, with no part moved "
        "between, before the run ends",
        minimum=1,
        maximum=1000,
    )
    on_inputs_lost: str = parameter(
        "resume",
        "when a watched node goes missing: hold and resume when it is back, or abort",
        choices=("resume", "abort"),
    )
    grasp: GraspParams = field(default_factory=GraspParams)
    opening: OpeningParams = field(default_factory=OpeningParams)
    wait: WaitParams = field(default_factory=WaitParams)


@dataclass(frozen=True)
class PolicyNodeParams(PolicyParams):
    """Parameters of the policy, and the nodes that it relies on."""

    base_frame: str = parameter("panda_link0", "frame of clouds, goals and decisions")
    autostart: bool = parameter(False, "start a run as soon as everything is there")
    watch_nodes: tuple[str, ...] = parameter(
        ("perception_node", "inference_node", "motion_node", "suction_node"),
        "nodes whose heartbeats the run depends on",
    )
    watch_timeout: float = parameter(
        0.7, "silence after which a node is missing, steady clock [s]", minimum=0.1, maximum=60.0
    )
    service_timeout: float = parameter(
        3.0, "wait for answers of suction and stop services [s]", minimum=0.1, maximum=60.0
    )
