"""What the analyses are made on: predictors by method, and the objects for each question."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.errors import CheckpointError, FlowBotError
from flowbothd_common.types import Cloud, History
from flowbothd_evaluation.paper.analysis.chains import AmbiguousDoor
from flowbothd_evaluation.paper.analysis.setting import Setting, setting_of
from flowbothd_evaluation.paper.analysis.showcases import Showcase
from flowbothd_evaluation.paper.figures.style import METHODS
from flowbothd_model import Predictor
from flowbothd_model.checkpoint import Checkpoint, read_checkpoint
from flowbothd_model.data.partnet import load_partnet
from flowbothd_model.data.procedural.catalogue import HELD_OUT_FROM, MAKERS, make
from flowbothd_model.data.splits import held_out_ids
from flowbothd_model.predictor import find_weights
from flowbothd_policy.predictor import FlowPredictor
from sim_bridge.objects.model import ObjectModel
from sim_bridge.objects.registry import load_object

COMPARED = ("flowbothd", "flowbot3d-ro", "flowbot3d-md")
"""The methods that the paper's analyses compare."""

_DOORS = ("8994", "8983", "9117")
_OCCLUDED = {"Door": ("8994", "9117"), "Refrigerator": ("10905",), "StorageFurniture": ("48381",)}
_MORE_OCCLUDED = ("9117", "12036", "49182")
_HALF_OPEN = ("12553", "8994", "48381", "10905", "101940")
_MORE_HALF_OPEN = ("8983", "9117", "12036", "49182", "7167", "22339", "46481", "102309")
_FURNITURE = ("12553", "10905", "48381", "101808", "103480", "22339", "7167", "10101", "100438")


class MissingInputError(FlowBotError):
    """An analysis cannot be made with what was given; the message says what it lacks."""


class Inputs:
    """Predictors and objects, loaded when an analysis first asks for them.

    Args:
        partnet: PartNet-Mobility objects, or None.
        weights: Method -> weights.
    """

    def __init__(self, partnet: Path | None, weights: Mapping[str, str]) -> None:
        self._partnet = partnet
        self._settings: dict[str, Setting] = {}
        self._checkpoints: dict[str, Checkpoint] = {}
        self._missing: dict[str, str] = {}
        self._predictors: dict[str, FlowPredictor] = {}
        for method, given in weights.items():
            try:
                file = find_weights(given)
                checkpoint = read_checkpoint(file)
                self._checkpoints[method] = checkpoint
            except CheckpointError as error:
                # The places that were searched say nothing to a reader of the report.
                self._missing[method] = f"no usable weights {given!r} ({error.__class__.__name__})"
                continue
            step = checkpoint.about.get("step", "?")
            model_id = f"{Path(given).name}@{step}"
            predictor = Predictor(checkpoint.network(), checkpoint.config, model_id)
            draws = checkpoint.config.network.latent > 0 or checkpoint.config.network.diffusion
            self._predictors[method] = predictor if draws else OneAnswer(predictor)

    @property
    def about(self) -> dict[str, str]:
        """Method -> what was loaded, or why not."""
        loaded = {method: one.model_id for method, one in self._predictors.items()}
        return {**loaded, **self._missing}

    @property
    def has_partnet(self) -> bool:
        """Whether there is any PartNet-Mobility object."""
        return any(self._folder(name) is not None for name in (*_DOORS, *_FURNITURE))

    @property
    def remembering(self) -> list[str]:
        """Methods whose network takes a history."""
        return [m for m, c in self._checkpoints.items() if c.config.network.history]

    def checkpoint(self, method: str) -> Checkpoint:
        """The weights of a method.

        Raises:
            MissingInputError: there are none.
        """
        if method not in self._checkpoints:
            raise MissingInputError(self._missing.get(method, f"no weights given for {method}"))
        return self._checkpoints[method]

    def main(self) -> FlowPredictor:
        """FlowBotHD.

        Raises:
            MissingInputError: it was not given.
        """
        self.checkpoint("flowbothd")
        return self._predictors["flowbothd"]

    def compared(self) -> dict[str, FlowPredictor]:
        """FlowBotHD and whichever of the baselines are there, in the order of the tables."""
        self.main()
        return {m: self._predictors[m] for m in METHODS if m in COMPARED and m in self._predictors}

    def doors(self, small: bool) -> list[Setting]:
        """Doors that no training saw: PartNet's, and by rule."""
        made = [self.made("Door", number) for number in range(3 if small else 12)]
        return [*self._found(_DOORS, "Door"), *made]

    def occluded(self, small: bool) -> list[Setting]:
        """A door, a refrigerator and furniture with hinges."""
        chosen = []
        for number, (category, names) in enumerate(_OCCLUDED.items()):
            found = self._found(names, category if category == "Door" else None)
            chosen.append(found[0] if found else self.made(category, number))
        taken = {setting.item.name for setting in chosen}
        more = [s for s in self._found(_MORE_OCCLUDED) if s.item.name not in taken]
        return chosen if small else [*chosen, *more]

    def closed(self, small: bool) -> list[Setting]:
        """Doors, and objects of other categories."""
        if small:
            others = self._found(_FURNITURE)
            categories = ("Oven", "Window", "StorageFurniture")
            return [*self.doors(small), *others, *(self.made(c, 0) for c in categories)]
        held_out = [name for name in held_out_ids() if name not in _DOORS]
        made = [self.made(c, k) for c in sorted(MAKERS) if c != "Door" for k in range(4)]
        return [*self.doors(small), *self._found(held_out), *made]

    def half_open(self, small: bool) -> list[Setting]:
        """Objects for the question of histories, the paper's dishwasher first."""
        found = self._found(_HALF_OPEN if small else (*_HALF_OPEN, *_MORE_HALF_OPEN))
        made = [self.made(c, 1) for c in ("Dishwasher", "Refrigerator", "Microwave", "Door")]
        return found if small and found else [*found, *made]

    def ambiguous(self, seed: int) -> list[Showcase]:
        """The paper's three kinds of ambiguous objects, and a part seen edge-on."""
        furniture = self._found(("48381",)) or [self.made("StorageFurniture", 1)]
        dishwasher = self._found(("12553",)) or [self.made("Dishwasher", 0)]
        door = self._found(("8994", "9117"), "Door") or [self.made("Door", 1)]
        return [
            Showcase(
                "No handle: push or pull, hinge left or right", AmbiguousDoor.make(seed).setting
            ),
            Showcase("Small handles that few points show: door or lid", furniture[0]),
            Showcase("A handle that fits a drawer, a door and a lid", dishwasher[0]),
            Showcase("Half open, and edge-on to the camera", door[0], 0.5, edge_on=True),
        ]

    def rollout_models(self) -> list[ObjectModel]:
        """The object for runs of the policy: a PartNet door, or furniture that needs no files."""
        for name, joint in (("8994", "joint_2"), ("9117", "joint_1")):
            folder = self._folder(name)
            if folder is not None:
                return [load_object(folder).with_target(joint)]
        return [load_object("cabinet_door", seed=1)]

    def made(self, category: str, number: int) -> Setting:
        """A held-out object by rule."""
        name = f"{category}-{number}"
        if name not in self._settings:
            self._settings[name] = setting_of(make(category, HELD_OUT_FROM + number))
        return self._settings[name]

    def _found(self, names: Sequence[str], category: str | None = None) -> list[Setting]:
        """Those of the PartNet-Mobility objects that are there."""
        settings = []
        for name in names:
            folder = self._folder(name)
            if folder is not None and name not in self._settings:
                self._settings[name] = setting_of(load_partnet(folder, category))
            if folder is not None:
                settings.append(self._settings[name])
        return settings

    def _folder(self, name: str) -> Path | None:
        """Where an object lies: as a folder, or below `train` or `raw`."""
        if self._partnet is None:
            return None
        places = [self._partnet / part / name for part in (".", "train", "raw")]
        return next((p for p in places if (p / "mobility.urdf").is_file()), None)


class OneAnswer:
    """A predictor that draws nothing, asked once and repeated for as many samples as wanted.

    Args:
        predictor: Whose samples of one cloud are all alike.
    """

    def __init__(self, predictor: FlowPredictor) -> None:
        self._predictor = predictor
        self.model_id = predictor.model_id

    def sample(
        self,
        points: Cloud,
        history: History | None = None,
        samples: int = 1,
        steps: int | None = None,
        sampler: str | None = None,
        seed: int | None = None,
    ) -> NDArray[np.float32]:
        """(samples, N, 3) flows, all the same."""
        flows = self._predictor.sample(points, history, 1, steps, sampler, seed)
        return np.repeat(flows, samples, axis=0)
