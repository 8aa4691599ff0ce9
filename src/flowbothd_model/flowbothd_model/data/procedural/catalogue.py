"""Which category is made by which rule."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from flowbothd_model.data.articulated import ArticulatedObject
from flowbothd_model.data.procedural import appliances, containers, devices, furniture, panels

Maker = Callable[[np.random.Generator, str], ArticulatedObject]

MAKERS: dict[str, Maker] = {
    "Box": containers.box,
    "Bucket": containers.bucket,
    "Dishwasher": appliances.dishwasher,
    "Door": panels.door,
    "FoldingChair": devices.folding_chair,
    "Kettle": containers.kettle,
    "KitchenPot": containers.kitchen_pot,
    "Laptop": devices.laptop,
    "Microwave": appliances.microwave,
    "Oven": appliances.oven,
    "Phone": devices.phone,
    "Refrigerator": appliances.refrigerator,
    "Safe": appliances.safe,
    "Stapler": devices.stapler,
    "StorageFurniture": furniture.storage,
    "Switch": devices.switch,
    "Table": furniture.table,
    "Toilet": containers.toilet,
    "TrashCan": containers.trash_can,
    "WashingMachine": appliances.washing_machine,
    "Window": panels.window,
}
"""The paper's 21 categories."""

HELD_OUT_FROM = 1_000_000_000
"""Procedural objects with this number or a higher one are for validation only."""


def make(category: str, number: int) -> ArticulatedObject:
    """Object `number` of a `category`; the same number always gives the same object.

    Raises:
        KeyError: the category is none of the paper's 21; the message lists them.
    """
    if category not in MAKERS:
        raise KeyError(f"no rule makes {category!r}; there are {sorted(MAKERS)}")
    rng = np.random.default_rng([number, sorted(MAKERS).index(category)])
    return MAKERS[category](rng, f"{category}-{number}")
