"""What is measured together, so that it can be measured again at any commit."""

from __future__ import annotations

from dataclasses import dataclass

from flowbothd_evaluation.paper.methods import METHODS
from flowbothd_evaluation.records import NONE, TRUTH
from flowbothd_model.data.splits import NEVER_TRAINED_ON, held_out_ids


@dataclass(frozen=True)
class Row:
    """One row of a table.

    Attributes:
        method: One of METHODS.
        switches: Parts of the policy that are on.
        policy: One of POLICIES.
        masks: Conventions under which it is measured.
    """

    method: str
    switches: tuple[str, ...]
    policy: str = "paper"
    masks: tuple[str, ...] = (TRUTH,)


@dataclass(frozen=True)
class Suite:
    """Objects and rows.

    Attributes:
        ids: PartNet-Mobility ids, none of which was trained on.
        rows: To be measured on all of them.
        trials: Repetitions.
    """

    ids: tuple[str, ...]
    rows: tuple[Row, ...]
    trials: int


_SG, _CC, _HF = ("SG",), ("SG", "CC"), ("SG", "HF")
_ALL = ("SG", "CC", "HF")
_BOTH = (TRUTH, NONE)

PAPER_ROWS = (
    Row("flowbot3d-ro", ()),
    Row("flowbot3d-ro", _SG),
    Row("flowbot3d-md", ()),
    Row("flowbot3d-md", _SG, masks=_BOTH),
    Row("flowbothd-nohistory", ()),
    Row("flowbothd-nohistory", _SG),
    Row("flowbothd-nohistory", _CC),
    Row("flowbothd-nodiffusion", _SG),
    Row("flowbothd-nodiffusion", _HF),
    Row("flowbothd", _SG),
    Row("flowbothd", _CC),
    Row("flowbothd", _HF),
    Row("flowbothd", _ALL, masks=_BOTH),
)
"""The rows of the paper's tables, in their order."""

_OURS = tuple(
    Row(name, METHODS[name].switches, "robot", masks)
    for name, masks in (
        ("flowbot3d-ro", (TRUTH,)),
        ("flowbot3d-md", _BOTH),
        ("flowbothd-nohistory", (TRUTH,)),
        ("flowbothd-nodiffusion", (TRUTH,)),
        ("flowbothd", _BOTH),
    )
)
"""The best switches of every method once more, under the robot's policy."""

_LIMITS = (Row("oracle", _SG, masks=_BOTH), Row("random", (), masks=_BOTH))

SMALL_IDS = (
    *("8994", "10905", "12036", "41083", "23472", "101940"),
    *("7167", "100174", "102622", "10101", "102181", "103480"),
)
"""Twelve objects with 17 links, of eleven categories."""

SUITES: dict[str, Suite] = {
    "small": Suite(SMALL_IDS, (*PAPER_ROWS, *_OURS, *_LIMITS), 2),
    "full": Suite(
        (*NEVER_TRAINED_ON, *held_out_ids()),
        (
            *(row for row in PAPER_ROWS if row.switches == METHODS[row.method].switches),
            _OURS[-1],
            *_LIMITS,
        ),
        5,
    ),
}
