"""The report: tables, figures and analyses of an evaluation as one Markdown page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flowbothd_evaluation.paper.methods import METHODS
from flowbothd_evaluation.paper.tables import Comparison, RowNumbers, compare, paper_row
from flowbothd_evaluation.paper.tables_text import (
    category_table,
    comparison_table,
    detail_table,
    markdown,
)
from flowbothd_evaluation.paper.trial import NONE, TRUTH

OURS = "flowbothd"
_LIMITS = ("oracle", "random")

_READING = """\
One trial: the object closed, one floating suction gripper, at most {steps} pulls of 0.17 m; opened
means an open ratio above 0.9. Links that the ground truth does not open either are left out and
counted below; whatever else happened to a trial, it counts. AVG_c is the mean over categories,
AVG_s over trials, with 95 % intervals: Wilson's for AVG_s, the others by drawing objects and their
trials anew (too narrow where a category has one object). SG, CC, HF: switch grasp, consistency
check, history filter. "Robot's policy": with what the policy on the arm adds to the paper's
algorithm (it keeps off edges, smooths the flow, turns pulls onto the surface normal, remembers only
what the motion bears out, and does not try again what has failed). In italics the paper's numbers,
of other objects of the same categories.

The paper's FlowBotHD is a diffusion chain of 100 steps, with and without history. Rows "our
one-step variant" are not: the shipped `compact*` weights are small networks trained by implicit
maximum likelihood, which map a random vector to a flow in a single step. "Our network": the same
network trained by regression, with one answer. Rows with other weights bear their name. In the
figures "ours" stands for all of these.
"""


@dataclass(frozen=True)
class Picture:
    """A figure of the report."""

    title: str
    path: Path


def page(
    title: str,
    rows: Sequence[RowNumbers],
    pictures: Sequence[Picture],
    analyses: Mapping[str, Any],
    sources: Sequence[Path],
) -> str:
    """The whole page.

    Args:
        title: Its first line.
        rows: Of all target masks.
        pictures: Drawn from the records, in `out`.
        analyses: By name, as `run_analyses` returns them; empty if they were not run.
        sources: Files of the records.
    """
    steps = sorted({r["max_steps"] for row in rows for r in row.records})
    parts = [
        f"# {title}",
        _READING.format(steps=" or ".join(map(str, steps))),
        _what(rows, sources),
    ]
    for mask, words in (
        (TRUTH, "Only points of the target link may be grasped"),
        (NONE, "The whole cloud may be grasped; opened if any link opened"),
    ):
        mine = [row for row in rows if row.key[3] == mask]
        if not mine:
            continue
        parts += [
            f"## {words}",
            "### Success rate",
            markdown(category_table(mine, "success")),
            "### Normalised distance (0 = open)",
            markdown(category_table(mine, "distance")),
            _verdict(mine),
        ]
    parts += [
        "## How trials ended",
        "The released code leaves trials without contact or without a visible target out of "
        '("released convention"); cosine, mean point error (the reference\'s "rmse") and root mean '
        "square error are those of the samples that were acted upon; seconds are medians.",
        markdown(detail_table(rows)),
    ]
    if pictures:
        parts.append("## From the records")
    parts += [f"### {p.title}\n\n![{p.title}]({p.path.name})" for p in pictures]
    if analyses:
        parts += ["## From the networks", *_analyses(analyses)]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def _what(rows: Sequence[RowNumbers], sources: Sequence[Path]) -> str:
    records = [r for row in rows for r in row.records]
    objects = sorted({(r["category"], r["object"]) for r in records})
    weights = sorted({(r["method"], r["weights"]) for r in records if r["weights"]})
    shut = sum(row.unopenable for row in rows)
    lines = [
        f"- Records: {len(records) + shut} from {', '.join(p.name for p in sources)}, of which "
        f"{shut} of links that the ground truth does not open.",
        "- Objects: " + ", ".join(f"{name} ({category})" for category, name in objects) + ".",
    ]
    if weights:
        used = ", ".join(
            f"`{name}` for {METHODS[m].titled(name)}" for m, name in weights if m in METHODS
        )
        lines.append(f"- Weights: {used}.")
    return "\n".join(lines)


def _verdict(rows: Sequence[RowNumbers]) -> str:
    """Compare FlowBotHD with the others, plainly, under each policy."""
    parts = []
    for policy in dict.fromkeys(row.key[2] for row in rows):
        same = [r for r in rows if r.key[2] == policy and r.key[0] not in _LIMITS]
        full = "+".join(METHODS[OURS].switches)
        first = next((r for r in same if r.key[:2] == (OURS, full)), None)
        others = [row for row in same if row is not first]
        if first is None or not others:
            continue
        found = [compare(first, row) for row in others]
        parts += [
            f"### {first.title}, against the others ({policy}'s policy, same trials)",
            markdown(comparison_table(first, found)),
            _words(first, others, found),
        ]
    return "\n\n".join(parts)


def _words(first: RowNumbers, others: Sequence[RowNumbers], found: Sequence[Comparison]) -> str:
    better = [r for r in others if first.success.mean > r.success.mean]
    equal = [r for r in others if first.success.mean == r.success.mean]
    worse = [r for r in others if first.success.mean < r.success.mean]
    sure = sum(c.difference.low > 0 for c in found)
    lines = [
        f"On the average over trials this row is above {len(better)} of the {len(others)} other "
        f"rows, equal to {len(equal)}, below {len(worse)}; above with an interval that excludes "
        f"zero: {sure}."
    ]
    for row in worse:
        entry = next(c for c in found if c.other == row.key)
        lost = ", ".join(f"{n} ({k}x)" for n, k in entry.only_other.items())
        ours, theirs = (list(paper_row(k, "success").values()) for k in (first.key, row.key))
        lines.append(
            f"- Below {row.title} [{row.key[1] or 'none'}] by "
            f"{row.success.mean - first.success.mean:.2f}: the other alone opened {lost}."
            + (" The paper has it the other way round." if sum(ours) > sum(theirs) > 0 else "")
        )
    return "\n".join(lines)


_SAYS = {
    "occlusion": "Where the leaf is seen edge-on, a prediction without history has little to go "
    "by.",
    "multimodality": "Several answers for one closed object: by the paper's rule right and wrong "
    "ones by mean error, by the released code's by cosine.",
    "doors": "Best of several samples; the paper's numbers in brackets are of other doors.",
    "history": "What the next prediction makes of no history, the true one, one of a good and one "
    "of a bad prediction: why only what moved may be remembered.",
    "chains": "How one answer comes about.",
    "rollouts": "Whole runs: predicted flow, grasp and pull, and what the policy noticed.",
    "showcases": "Objects whose opening cannot be seen, with the answers that are drawn for them.",
}


def _analyses(analyses: Mapping[str, Any]) -> list[str]:
    parts = ["What was measured on what is in [analyses.json](analyses.json)."]
    for name, found in analyses.items():
        if "skipped" in found:
            parts.append(f"Not made, {name}: {found['skipped']}.")
            continue
        parts.append(_SAYS.get(name, ""))
        if table := found["data"].get("table"):
            parts.append(str(table))
        parts += [f"### {title}\n\n![{title}]({file})" for title, file in found["figures"]]
    return parts
