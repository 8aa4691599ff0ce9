"""`flowbothd eval report`: tables, figures and analyses of all experiments, as one report."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from flowbothd_common.errors import ParameterError
from flowbothd_evaluation.arm.table import table as arm_table
from flowbothd_evaluation.openings.runs import table as openings_table
from flowbothd_evaluation.openings.task import load_openings
from flowbothd_evaluation.paper.analysis import ANALYSES
from flowbothd_evaluation.paper.methods import METHODS, weights_given
from flowbothd_evaluation.paper.report_page import Picture, analysis_parts, paper_parts
from flowbothd_evaluation.paper.tables import RowKey, RowNumbers, row_key, row_title, rows_of
from flowbothd_evaluation.paper.tables_text import category_table, latex, markdown
from flowbothd_evaluation.record_files import read_any
from flowbothd_evaluation.records import TRUTH, ArmRecord, OpeningRecord, PaperRecord

_CAPTIONS = {
    "success": "Success rate, averaged over categories and over samples, with 95 % intervals, and "
    "by category with the number of trials. In italics the paper's numbers; unlike its FlowBotHD, "
    "our one-step variant is trained by implicit maximum likelihood and has no diffusion chain.",
    "distance": "Normalised distance to fully open, likewise; lower is better.",
}

_ALL = "all"


@dataclass
class Results:
    """Records by experiment.

    Attributes:
        paper: Trials of `flowbothd eval paper`.
        arm: Trials of `flowbothd eval arm`.
        openings: Runs of `flowbothd eval openings`.
    """

    paper: list[PaperRecord] = field(default_factory=list)
    arm: list[ArmRecord] = field(default_factory=list)
    openings: list[OpeningRecord] = field(default_factory=list)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `flowbothd eval report`."""
    add = parser.add_argument
    add(
        "results",
        type=Path,
        nargs="*",
        metavar="FILE",
        help="files that `flowbothd eval paper`, `arm` or `openings` wrote, also compressed (.gz)",
    )
    add(
        "--out",
        type=Path,
        default=Path("out/report"),
        help="folder of the report: README.md, tables.tex, pictures (default: %(default)s)",
    )
    add("--title", default="The experiments", help="of the report")
    add(
        "--analyses",
        nargs="+",
        choices=(*ANALYSES, _ALL),
        default=[],
        metavar="NAME",
        help="what the networks predict outside a run; takes minutes: "
        f"{_ALL}, or any of {', '.join(ANALYSES)} (default: none)",
    )
    add(
        "--objects",
        type=Path,
        metavar="PARTNET",
        help="PartNet-Mobility folders for the analyses; without, they take procedural objects",
    )
    add("--clouds", type=Path, metavar="DIR", help="recorded clouds for the analysis of that name")
    add(
        "--weights",
        nargs="+",
        default=[],
        metavar="METHOD=PATH",
        help="weights for the analyses (default: those of the records, or the method's own); as "
        "method diffusion: weights with a denoising chain",
    )
    add("--full", action="store_true", help="analyses of all held-out objects, not of a few")
    add("--seed", type=int, default=0, help="of the analyses (default: %(default)s)")


def run(arguments: argparse.Namespace) -> int:
    """Write the report and print its main tables."""
    if not arguments.results and not arguments.analyses:
        raise ParameterError(
            "there is nothing to report", hint="give files of records, or --analyses"
        )
    weights = weights_given(arguments.weights, also=("diffusion",))
    results = load(arguments.results)
    rows = rows_of(results.paper)
    out: Path = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    from flowbothd_evaluation.paper.figures import draw_all

    pictures = [Picture(title, path) for title, path in draw_all(results.paper, out)]
    parts = paper_parts(rows, pictures, arguments.results)
    shown = [
        f"target mask {mask}\n\n"
        + markdown(category_table([row for row in rows if row.key[3] == mask], "success"))
        for mask in dict.fromkeys(row.key[3] for row in rows)
    ]
    for title, table in _other_tables(results):
        parts += [f"## {title}", table]
        shown.append(f"{title}\n\n{table}")
    if rows:
        (out / "tables.tex").write_text(_latex(rows))
    if arguments.analyses:
        parts += analysis_parts(_analyses(results.paper, weights, arguments))
    text = "\n\n".join(part.strip() for part in (f"# {arguments.title}", *parts)) + "\n"
    (out / "README.md").write_text(text)
    shown.append(f"report: {out / 'README.md'}")
    sys.stdout.write("\n" + "\n\n".join(shown) + "\n")
    return 0


def load(paths: Sequence[Path]) -> Results:
    """Read the records of several files.

    Raises:
        RecordError: a file is missing or empty, or holds something else.
        ParameterError: one row of the paper's tables has records of several weights.
    """
    results = Results()
    for record in (record for path in paths for record in read_any(path)):
        if isinstance(record, PaperRecord):
            results.paper.append(record)
        elif isinstance(record, ArmRecord):
            results.arm.append(record)
        else:
            results.openings.append(record)
    _check_weights(results.paper)
    return results


def _check_weights(records: Sequence[PaperRecord]) -> None:
    """Refuse rows whose records come from several weights."""
    of_row: dict[RowKey, set[str]] = {}
    for record in records:
        name = f"{record.weights} {record.weights_sha256}".strip()
        of_row.setdefault(row_key(record), set()).add(name)
    for key, names in of_row.items():
        if len(names) > 1:
            raise ParameterError(
                f"records of {row_title(key)} [{key[1] or 'none'}] come from several weights",
                got=", ".join(sorted(names)),
                hint="a file of records for each, and a report for each",
            )


def _other_tables(results: Results) -> list[tuple[str, str]]:
    """Titles and tables of the arm's trials and of openings."""
    found = []
    if results.arm:
        found.append(("Trials of the arm", arm_table(sorted(results.arm, key=lambda r: r.key))))
    if results.openings:
        tasks = load_openings(list(dict.fromkeys(r.task for r in results.openings)))
        found.append(("Openings with the true flow", openings_table(tasks, results.openings)))
    return found


def _analyses(
    records: Sequence[PaperRecord], given: dict[str, str], arguments: argparse.Namespace
) -> dict[str, Any]:
    from flowbothd_evaluation.paper.analysis.run import run_analyses

    used = {m.name: m.weights for m in METHODS.values() if m.weights}
    used |= {r.method: r.weights for r in records if r.weights} | given
    found: dict[str, Any] = run_analyses(
        arguments.objects,
        used,
        arguments.out,
        seed=arguments.seed,
        small=not arguments.full,
        only=() if _ALL in arguments.analyses else arguments.analyses,
        clouds=arguments.clouds,
    )["analyses"]
    return found


def _latex(rows: Sequence[RowNumbers]) -> str:
    mine = [row for row in rows if row.key[3] == TRUTH] or list(rows)
    parts = [latex(category_table(mine, name), _CAPTIONS[name]) for name in _CAPTIONS]
    return "\n\n".join(parts) + "\n"
