"""The table of the arm's trials."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import mean

from flowbothd_common.markdown import markdown_table
from flowbothd_evaluation.records import ArmRecord
from flowbothd_evaluation.run_record.record import OPEN

_HEAD = (
    *("object", "mode or joint", "method", "opened", "left open", "mean open ratio", "steps"),
    *("grasps", "peak force [N]", "arm touched [N]", "not opened because"),
)
_LONGEST_REASONS = 160
"""Characters of the last column: the file of records has all of them."""


def table(records: Sequence[ArmRecord]) -> str:
    """Return two tables in Markdown: by object, mode or joint and method, and the totals."""
    rows: dict[tuple[str, str, str, str], list[ArmRecord]] = {}
    totals: dict[tuple[str, str, str], list[ArmRecord]] = {}
    for record in records:
        whole = (record.suite, record.object, record.method)
        rows.setdefault((*whole, record.mode or record.target), []).append(record)
        totals.setdefault(whole, []).append(record)
    parts = [
        markdown_table(
            _HEAD, [_row(name, part, method, own) for (_, name, method, part), own in rows.items()]
        ),
        markdown_table(
            ("object", "method", "opened"),
            [
                (name, method, f"**{_opened(own)} of {len(own)}**")
                for (_, name, method), own in totals.items()
            ],
        ),
    ]
    return "\n\n".join(parts)


def _row(name: str, part: str, method: str, records: Sequence[ArmRecord]) -> tuple[str, ...]:
    failures = sorted({f"{r.outcome}: {r.reason}" for r in records if not r.success})
    return (
        name,
        part,
        method,
        f"{_opened(records)} of {len(records)}",
        f"{sum(r.open_ratio_left > OPEN for r in records)}",
        f"{mean(r.open_ratio for r in records):.2f}",
        f"{mean(r.steps for r in records):.1f}",
        f"{mean(r.grasps for r in records):.1f}",
        f"{max(r.peak_force for r in records):.0f}",
        _touched(records),
        "; ".join(failures)[:_LONGEST_REASONS],
    )


def _opened(records: Sequence[ArmRecord]) -> int:
    return sum(record.success for record in records)


def _touched(records: Sequence[ArmRecord]) -> str:
    """Runs in which anything but the cup touched object or table, and the largest force."""
    worst = [max(record.contacts.values()) for record in records if record.contacts]
    return f"{len(worst)} runs, up to {max(worst):.0f}" if worst else "never"
