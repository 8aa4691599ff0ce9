"""`flowbothd tables`: records into the paper's tables and figures, as one report."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from flowbothd_common.errors import ParameterError
from flowbothd_evaluation.paper.methods import METHODS
from flowbothd_evaluation.paper.report_page import Picture, page
from flowbothd_evaluation.paper.tables import RowKey, RowNumbers, row_key, row_title, rows_of
from flowbothd_evaluation.paper.tables_text import category_table, latex, markdown
from flowbothd_evaluation.paper.trial import TRUTH
from flowbothd_evaluation.resumable import Record, read_records

_CAPTIONS = {
    "success": "Success rate, averaged over categories and over samples, with 95 % intervals, and "
    "by category with the number of trials. In italics the paper's numbers; unlike its FlowBotHD, "
    "our one-step variant is trained by implicit maximum likelihood and has no diffusion chain.",
    "distance": "Normalised distance to fully open, likewise; lower is better.",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `flowbothd tables`."""
    parser.add_argument("results", type=Path, nargs="+", help="files that `flowbothd eval` wrote")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out/report"),
        help="folder of the report: README.md, tables.tex, pictures (default: %(default)s)",
    )
    parser.add_argument(
        "--objects",
        type=Path,
        metavar="PARTNET",
        help="PartNet-Mobility folders for the analyses of the networks; without, those on "
        "procedural objects alone",
    )
    parser.add_argument(
        "--no-analyses",
        action="store_true",
        help="only what comes from the records; analyses run the networks and take minutes",
    )
    parser.add_argument("--title", default="The paper's experiments", help="of the report")


def run(arguments: argparse.Namespace) -> int:
    """Write the report and print its main tables."""
    records = load(arguments.results)
    rows = rows_of(records)
    out = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    from flowbothd_evaluation.paper.figures import draw_all

    pictures = [Picture(title, path) for title, path in draw_all(records, out)]
    analyses = {} if arguments.no_analyses else _analyses(records, arguments.objects, out)
    text = page(arguments.title, rows, pictures, analyses, arguments.results)
    (out / "README.md").write_text(text)
    (out / "tables.tex").write_text(_latex(rows))
    for mask in dict.fromkeys(row.key[3] for row in rows):
        sys.stdout.write(f"\ntarget mask {mask}\n\n")
        mine = [row for row in rows if row.key[3] == mask]
        sys.stdout.write(markdown(category_table(mine, "success")) + "\n")
    sys.stdout.write(f"\nreport: {out / 'README.md'}\n")
    return 0


def load(paths: Sequence[Path]) -> list[Record]:
    """Records of several files.

    Raises:
        ParameterError: a file is missing or empty, a record is of something else, or one row has
            records of several weights.
    """
    records: list[Record] = []
    for path in paths:
        found = read_records(path)
        needed = {"method", "switches", "policy", "target_mask", "outcome", "per_step"}
        foreign = next((r for r in found if not needed <= set(r)), None)
        if not found or foreign is not None:
            raise ParameterError(
                f"{path} holds no records of `flowbothd eval`",
                got="nothing" if not found else f"a record with {', '.join(sorted(foreign or {}))}",
            )
        records += found
    _check_weights(records)
    return records


def _check_weights(records: Sequence[Record]) -> None:
    """Refuse rows whose records come from several weights."""
    of_row: dict[RowKey, set[str]] = {}
    for record in records:
        name = f"{record['weights']} {record.get('weights_sha256', '')}".strip()
        of_row.setdefault(row_key(record), set()).add(name)
    for key, names in of_row.items():
        if len(names) > 1:
            raise ParameterError(
                f"records of {row_title(key)} [{key[1] or 'none'}] come from several weights",
                got=", ".join(sorted(names)),
                hint="a file of records for each, and a report for each",
            )


def _analyses(records: Sequence[Record], partnet: Path | None, out: Path) -> dict[str, object]:
    from flowbothd_evaluation.paper.analysis.run import run_analyses

    used = {m.name: m.weights for m in METHODS.values() if m.weights}
    used |= {r["method"]: r["weights"] for r in records if r["weights"]}
    found: dict[str, object] = run_analyses(partnet, used, out)["analyses"]
    return found


def _latex(rows: Sequence[RowNumbers]) -> str:
    mine = [row for row in rows if row.key[3] == TRUTH] or list(rows)
    parts = [latex(category_table(mine, name), _CAPTIONS[name]) for name in _CAPTIONS]
    return "\n\n".join(parts) + "\n"
