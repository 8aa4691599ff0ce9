"""The tables as Markdown and LaTeX."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from flowbothd_evaluation.paper.methods import SWITCHES
from flowbothd_evaluation.paper.tables import Comparison, Interval, RowNumbers, paper_row

Table = list[list[str]]
"""Rows of cells, the head first."""

_MARKS = ("–", "✓")


def category_table(rows: Sequence[RowNumbers], table: str) -> Table:
    """Success rates or normalised distances: averages with intervals, then one column a category.

    Below a row that the paper has, its own numbers, averaged over the categories at hand: over
    samples with our counts.

    Args:
        rows: Of the same target mask.
        table: success or distance.
    """
    names = sorted({name for row in rows for name in row.categories})
    counts = {name: max(row.categories.get(name, (0, 0, 0))[2] for row in rows) for name in names}
    head = ["method", *SWITCHES, "AVG_c", "AVG_s", "trials"]
    lines: Table = [[*head, *(f"{name} ({counts[name]})" for name in names)]]
    for row in rows:
        by_category = row.success_by_category if table == "success" else row.distance_by_category
        by_sample = row.success if table == "success" else row.distance
        column = 0 if table == "success" else 1
        values = {name: found[column] for name, found in row.categories.items()}
        lines.append(
            [
                row.title,
                *_switches(row.key[1]),
                interval(by_category),
                interval(by_sample),
                str(len(row.records)),
                *(_number(values.get(name)) for name in names),
            ]
        )
        paper = {n: v for n, v in paper_row(row.key, table).items() if n in row.categories}
        if paper:
            weights = [row.categories[name][2] for name in paper]
            averages = (
                np.mean(list(paper.values())),
                np.average(list(paper.values()), weights=weights),
            )
            lines.append(
                [
                    "  *the paper*",
                    *[""] * len(SWITCHES),
                    *(f"*{value:.2f}*" for value in averages),
                    "",
                    *(f"*{paper[name]:.2f}*" if name in paper else "" for name in names),
                ]
            )
    return lines


def detail_table(rows: Sequence[RowNumbers]) -> Table:
    """How trials ended, and what the acted-upon samples were like."""
    outcomes = sorted({name for row in rows for name in row.outcomes})
    head = ["method", "switches", "target mask", *outcomes, "released convention", "pulls"]
    head += ["contacts", "cosine", "mean error", "rmse", "seconds"]
    lines: Table = [head]
    for row in rows:
        figures = (row.released, row.steps, row.grasps, row.cosine, row.mean_error, row.rmse)
        lines.append(
            [
                row.title,
                row.key[1] or "none",
                row.key[3],
                *(str(row.outcomes.get(name, 0)) for name in outcomes),
                *(_number(value) for value in (*figures, row.seconds)),
            ]
        )
    return lines


def comparison_table(first: RowNumbers, found: Sequence[Comparison]) -> Table:
    """One row against others on the same trials."""
    lines: Table = [
        [
            f"{first.title} [{first.key[1] or 'none'}] against",
            "trials",
            "difference of the success rates",
            "opened by it alone",
            "by the other alone",
            "",
        ]
    ]
    for entry in found:
        lost = sorted(entry.only_other.items(), key=lambda item: -item[1])
        lines.append(
            [
                f"{entry.other_title} [{entry.other[1] or 'none'}]",
                str(entry.trials),
                interval(entry.difference, sign=True),
                str(entry.only_first),
                str(sum(entry.only_other.values())),
                ", ".join(f"{name} {count}x" for name, count in lost[:6]),
            ]
        )
    return lines


def markdown(table: Table) -> str:
    """The table in Markdown."""
    head, *rest = table
    lines = ["| " + " | ".join(row) + " |" for row in (head, ["---"] * len(head), *rest)]
    return "\n".join(lines)


def latex(table: Table, caption: str) -> str:
    """The table in LaTeX (booktabs)."""
    head, *rest = table
    body = [" & ".join(_tex(cell) for cell in row) + r" \\" for row in rest]
    return "\n".join(
        [
            r"\begin{table*}[ht]",
            r"\centering\footnotesize\setlength\tabcolsep{.3em}",
            r"\resizebox{\textwidth}{!}{\begin{tabular}{l" + "c" * (len(head) - 1) + "}",
            r"\toprule",
            " & ".join(_tex(cell) for cell in head) + r" \\",
            r"\midrule",
            *body,
            r"\bottomrule",
            r"\end{tabular}}",
            rf"\caption{{{_tex(caption)}}}",
            r"\end{table*}",
        ]
    )


def interval(value: Interval, *, sign: bool = False) -> str:
    """Mean and interval, as `0.87 [0.80, 0.92]`."""
    if np.isnan(value.mean):
        return "–"
    shape: Callable[[float], str] = lambda x: f"{x:+.2f}" if sign else f"{x:.2f}"  # noqa: E731
    return f"{shape(value.mean)} [{shape(value.low)}, {shape(value.high)}]"


def _switches(text: str) -> list[str]:
    return [_MARKS[switch in text.split("+")] for switch in SWITCHES]


def _number(value: float | None) -> str:
    return "–" if value is None or np.isnan(value) else f"{value:.2f}"


def _tex(cell: str) -> str:
    if cell.strip().startswith("*"):
        return rf"\textit{{{_tex(cell.strip().strip('*'))}}}"
    for old, new in (
        ("\\", r"\textbackslash "),
        ("_", r"\_"),
        ("%", r"\%"),
        ("&", r"\&"),
        ("✓", r"$\checkmark$"),
        ("–", r"--"),
    ):
        cell = cell.replace(old, new)
    return cell
