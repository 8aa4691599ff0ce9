"""Who predicts in a trial, and with which parts of the policy switched on."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.errors import ParameterError
from flowbothd_common.types import Cloud, History, max_normalised
from flowbothd_evaluation.rollout.floating import FLOATING_POLICY
from flowbothd_policy.params import PolicyParams
from flowbothd_policy.predictor import FlowPredictor

SWITCHES = ("SG", "CC", "HF")
"""Switch grasp, consistency check, history filter."""

POLICIES = ("paper", "robot")
"""The paper's algorithm as it stands, or with what the robot's policy adds to it."""


@dataclass(frozen=True)
class Method:
    """A row of the paper's table before its switches.

    Attributes:
        name: As on the command line.
        title: The paper's name of the row.
        weights: Name or path of weights; empty for methods without.
        variant: Description of these weights, for titles next to the paper's numbers.
        switches: What is on unless the command line says otherwise: the paper's best row.
        draws: Whether another sample can be another answer.
    """

    name: str
    title: str
    weights: str = ""
    switches: tuple[str, ...] = ()
    draws: bool = False
    variant: str = ""

    def titled(self, weights: str = "") -> str:
        """Return the title with the network behind it: the method's own weights, or others."""
        if not self.weights:
            return self.title
        own = weights in ("", self.weights)
        return f"{self.title}, {self.variant if own else f'weights {weights}'}"


_ONE_STEP = "our one-step variant"
"""The shipped weights are trained by implicit maximum likelihood: no diffusion chain as in the
paper."""

METHODS: dict[str, Method] = {
    m.name: m
    for m in (
        Method("flowbothd", "FlowBotHD", "compact", ("SG", "CC", "HF"), True, _ONE_STEP),
        Method(
            "flowbothd-nohistory",
            "No history",
            "compact-no-history",
            ("SG", "CC"),
            True,
            _ONE_STEP,
        ),
        Method(
            "flowbothd-nodiffusion",
            "No diffusion",
            "compact-no-diffusion",
            ("SG", "HF"),
            variant="our network with one answer",
        ),
        Method(
            "flowbot3d-ro",
            "FlowBot3D (RO)",
            "compact-flowbot3d-ro",
            ("SG",),
            variant="our network",
        ),
        Method(
            "flowbot3d-md",
            "FlowBot3D (MD)",
            "compact-flowbot3d-md",
            ("SG",),
            variant="our network",
        ),
        Method("oracle", "Ground truth", "", ("SG",)),
        Method("random", "Random", "", (), True),
    )
}


def method(name: str) -> Method:
    """The method of a name.

    Raises:
        ParameterError: there is none.
    """
    if name not in METHODS:
        raise ParameterError("no such method", got=name, allowed=list(METHODS))
    return METHODS[name]


def parse_switches(text: str) -> tuple[str, ...]:
    """`SG+CC` and the like, in the order of SWITCHES; `none` for none.

    Raises:
        ParameterError: something else is named.
    """
    named = [] if text in ("", "none") else text.split("+")
    unknown = sorted(set(named) - set(SWITCHES))
    if unknown:
        raise ParameterError(
            "no such switch of the policy",
            got="+".join(unknown),
            allowed="all, none, or any of SG, CC, HF joined by +",
        )
    return tuple(switch for switch in SWITCHES if switch in named)


def every_combination() -> list[tuple[str, ...]]:
    """All eight, fewest first."""
    return [c for n in range(4) for c in itertools.combinations(SWITCHES, n)]


def policy_params(
    chosen: Method, switches: tuple[str, ...], policy: str, steps: int, seed: int
) -> PolicyParams:
    """The policy of one trial.

    `paper` is Algorithm 1 with the paper's thresholds: it pulls at the point of the largest flow,
    along that flow, and forgets what failed. `robot` is what runs on the arm: it keeps off edges,
    smooths the flow, turns pulls onto the surface normal, and does not try again what failed.
    In both a trial ends with its steps, not with the number of contacts.

    Raises:
        ParameterError: no such policy.
    """
    if policy not in POLICIES:
        raise ParameterError("no such policy", got=policy, allowed=POLICIES)
    params = replace(
        FLOATING_POLICY,
        seed=seed,
        max_steps=steps,
        max_recontacts=steps,
        switch_grasp="SG" in switches,
        consistency_check="CC" in switches,
        history_filter="HF" in switches,
        # Samples of one cloud share its encoding, which is most of the work.
        samples_per_request=8 if chosen.draws and "CC" in switches else 1,
    )
    if policy == "robot":
        return params
    return replace(
        params,
        reject_failed_directions=False,
        occluded_leverage_from_screw=False,
        recontact_consistency="last",
        history_agreement=np.pi,
        grasp=replace(params.grasp, edge_margin=0.0, direction="flow", normal_angle=0.0),
    )


class RandomPredictor:
    """Every point is predicted to move somewhere: the floor of every table."""

    model_id = "random"

    def sample(
        self,
        points: Cloud,
        history: History | None = None,
        samples: int = 1,
        steps: int | None = None,
        sampler: str | None = None,
        seed: int | None = None,
    ) -> NDArray[np.float32]:
        """(samples, N, 3) independent Gaussian vectors; see `FlowPredictor.sample`."""
        rng = np.random.default_rng(seed)
        return max_normalised(rng.normal(size=(samples, len(points), 3)))


@lru_cache(maxsize=2)
def load_weights(name: str, digest: str = "") -> FlowPredictor:
    """The network, loaded once in a process; one thread, since trials run side by side.

    Args:
        name: Name or path.
        digest: Of the file, where it may have been written anew since.
    """
    import torch

    from flowbothd_model import load

    torch.set_num_threads(1)
    return load(name)


def weights_digest(name: str) -> str:
    """First 16 digits of the sha256 of a file of weights; empty for none.

    Raises:
        CheckpointError: no such weights, or the file is damaged.
    """
    if not name:
        return ""
    from flowbothd_model.checkpoint import read_checkpoint, weights_hash
    from flowbothd_model.predictor import find_weights

    file = find_weights(name)
    read_checkpoint(file)
    return weights_hash(file)[:16]


def weights_given(texts: Sequence[str], also: Sequence[str] = ()) -> dict[str, str]:
    """Return weights by method from `METHOD=PATH` of a command line.

    Args:
        texts: As they were given.
        also: Names that are allowed besides METHODS.

    Raises:
        ParameterError: one is something else.
    """
    found = {}
    for text in texts:
        name, separator, path = text.partition("=")
        allowed = [*METHODS, *also]
        if not separator or name not in allowed:
            raise ParameterError(
                "weights for a method", got=text, allowed=f"METHOD=PATH, METHOD of {allowed}"
            )
        found[name] = path
    return found


def weights_of(chosen: Method, given: Mapping[str, str]) -> str:
    """Weights of a method: those given for it by name, or its own."""
    return given.get(chosen.name, chosen.weights)
