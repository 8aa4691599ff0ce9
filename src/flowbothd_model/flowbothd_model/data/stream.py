"""Endless batches: element i of batch b is the same in any process, so any run can resume."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Protocol

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import IterableDataset, get_worker_info

from flowbothd_common.errors import ObjectModelError
from flowbothd_model.data.articulated import ArticulatedObject
from flowbothd_model.data.partnet import load_partnet
from flowbothd_model.data.procedural.catalogue import HELD_OUT_FROM, MAKERS, make
from flowbothd_model.data.sampling import Sample, SampleConfig, Situation, draw_sample

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Batch:
    """Stacked samples.

    Attributes:
        points: (B, N, 3) float32 [m].
        flow: (B, N, 3) float32, max-normalised.
        history_points: (B, M, 3); zero where there is no history.
        history_flow: (B, M, 3).
        has_history: (B,) bool.
    """

    points: Tensor
    flow: Tensor
    history_points: Tensor
    history_flow: Tensor
    has_history: Tensor

    def to(self, device: torch.device | str) -> Batch:
        """The batch on a device."""
        return Batch(*(getattr(self, f.name).to(device) for f in fields(self)))


class ObjectSource(Protocol):
    """Something that objects can be drawn from."""

    def draw(self, rng: np.random.Generator) -> ArticulatedObject:
        """One object."""
        ...


class ProceduralSource:
    """Objects made by rule, a different one for each draw.

    Args:
        weights: Relative frequency of categories; 1 where nothing is said.
        held_out: Draw from the validation numbers instead.
    """

    def __init__(self, weights: Mapping[str, float] | None = None, held_out: bool = False) -> None:
        self._names = sorted(MAKERS)
        share = np.array([dict(weights or {}).get(name, 1.0) for name in self._names])
        self._share = share / share.sum()
        self._offset = HELD_OUT_FROM if held_out else 0

    def draw(self, rng: np.random.Generator) -> ArticulatedObject:
        """One object of a random category."""
        category = self._names[int(rng.choice(len(self._names), p=self._share))]
        return make(category, self._offset + int(rng.integers(HELD_OUT_FROM)))


class PartNetSource:
    """PartNet-Mobility folders, loaded once; rare categories are drawn more often.

    Args:
        folders: Of the objects; those that cannot be read are left out with a warning.
        stretch: Scale the three axes of an object by up to this share, independently.
    """

    def __init__(self, folders: Sequence[Path], stretch: float = 0.0) -> None:
        self.objects: list[ArticulatedObject] = []
        for folder in folders:
            try:
                self.objects.append(load_partnet(folder))
            except ObjectModelError as error:
                log.warning("left out: %s", error)
        if not self.objects:
            raise ObjectModelError("no PartNet-Mobility object could be read", got=len(folders))
        names = [item.category for item in self.objects]
        share = np.array([names.count(name) ** -0.5 for name in names])
        self._share = share / share.sum()
        self._stretch = stretch

    def draw(self, rng: np.random.Generator) -> ArticulatedObject:
        """One object."""
        item = self.objects[int(rng.choice(len(self.objects), p=self._share))]
        return stretched(item, rng.uniform(1 - self._stretch, 1 + self._stretch, 2))


def stretched(item: ArticulatedObject, factors: np.ndarray) -> ArticulatedObject:
    """Scale x, y (by factors[0]) and z (by factors[1]), or only z where that would bend a hinge.

    A hinge about z keeps its circles when x and y are scaled alike. For any other axis, and for
    hinges about it, the object is scaled as a whole, which needs no change of the joints.
    """
    upright = all(
        abs(joint.axis[2]) > 0.999 or joint.kind != "revolute"
        for joint in item.joints
        if joint.movable
    )
    if not upright or not np.ptp(factors):
        return item
    scale = np.array([factors[0], factors[0], factors[1]])
    joints = []
    for joint in item.joints:
        point = np.asarray(joint.point) * scale
        axis = np.asarray(joint.axis)
        if joint.kind == "prismatic":
            axis = axis * scale
            length = float(np.linalg.norm(axis))
            axis = axis / length
            joint = replace(joint, lower=joint.lower * length, upper=joint.upper * length)
        joints.append(
            replace(
                joint,
                axis=(float(axis[0]), float(axis[1]), float(axis[2])),
                point=(float(point[0]), float(point[1]), float(point[2])),
            )
        )
    vertices = (item.vertices * scale).astype(np.float32)
    return replace(item, vertices=vertices, joints=tuple(joints))


@dataclass(frozen=True)
class Mixture:
    """Objects and settings that batches are drawn from.

    Attributes:
        sources: With their relative weights.
        sample: How samples are drawn.
        situations: With their relative weights; the paper takes thirds.
        seed: Of everything.
    """

    sources: tuple[tuple[ObjectSource, float], ...]
    sample: SampleConfig = field(default_factory=SampleConfig)
    situations: tuple[tuple[Situation, float], ...] = (
        (Situation.CLOSED, 1.0),
        (Situation.OPEN, 1.0),
        (Situation.HISTORY, 1.0),
    )
    seed: int = 0

    def sample_at(self, batch: int, element: int) -> Sample:
        """Element `element` of batch `batch`, always the same."""
        rng = np.random.default_rng([self.seed, batch, element])
        source_share = np.array([weight for _, weight in self.sources])
        situation_share = np.array([weight for _, weight in self.situations])
        while True:
            source = self.sources[
                int(rng.choice(len(source_share), p=source_share / source_share.sum()))
            ][0]
            chosen = int(
                rng.choice(len(situation_share), p=situation_share / situation_share.sum())
            )
            item = source.draw(rng)
            sample = draw_sample(item, self.situations[chosen][0], self.sample, rng)
            if sample is not None:
                return sample


class BatchStream(IterableDataset[Batch]):
    """Batches `first`, `first + stride`, ... of a mixture, shared among data workers.

    Args:
        mixture: What to draw from.
        batch_size: Samples per batch.
        first: Number of the first batch, e.g. the step to resume at.
        stride: Distance between batches, the number of training processes.
    """

    def __init__(self, mixture: Mixture, batch_size: int, first: int = 0, stride: int = 1) -> None:
        self._mixture = mixture
        self._size = batch_size
        self._first = first
        self._stride = stride

    def __iter__(self) -> Iterator[Batch]:
        """Endless."""
        worker = get_worker_info()
        index, count = (worker.id, worker.num_workers) if worker is not None else (0, 1)
        number = self._first + index * self._stride
        while True:
            yield collate([self._mixture.sample_at(number, i) for i in range(self._size)])
            number += count * self._stride


def collate(samples: Sequence[Sample]) -> Batch:
    """Stack samples with equal numbers of points."""

    def stack(arrays: list[np.ndarray]) -> Tensor:
        return torch.from_numpy(np.stack(arrays).astype(np.float32))

    histories = [s.history if s.history is not None else s.current for s in samples]
    has = torch.tensor([s.history is not None for s in samples])
    mask = has[:, None, None].float()
    return Batch(
        stack([s.current.points for s in samples]),
        stack([s.current.flow for s in samples]),
        stack([h.points for h in histories]) * mask,
        stack([h.flow for h in histories]) * mask,
        has,
    )
