"""Tables in Markdown, as reports, benchmarks and generated documentation write them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def markdown_table(head: Sequence[object], rows: Iterable[Sequence[object]]) -> str:
    """Return a table; a bar or a line break in a cell does not break it.

    Args:
        head: Column titles.
        rows: Cells of each row, as many as there are titles; shown as `str` shows them.

    Raises:
        ValueError: a row has another number of cells than the head.
    """
    lines = [_line(head), "|" + "---|" * len(head)]
    for row in rows:
        if len(row) != len(head):
            raise ValueError(f"a row of {len(row)} cells under {len(head)} titles: {list(row)}")
        lines.append(_line(row))
    return "\n".join(lines)


def _line(cells: Sequence[object]) -> str:
    return "| " + " | ".join(_cell(cell) for cell in cells) + " |"


def _cell(value: object) -> str:
    return " ".join(str(value).split("\n")).replace("|", "\\|")
