"""How methods look in every figure, and how figures are saved: small, and the same each time."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.figure import Figure
from PIL import Image

METHODS = {
    "flowbothd": ("FlowBotHD (ours)", "#0072b2"),
    "flowbothd-nohistory": ("no history (ours)", "#56b4e9"),
    "flowbothd-nodiffusion": ("no diffusion (ours)", "#009e73"),
    "flowbot3d-ro": ("FlowBot3D (RO, ours)", "#d55e00"),
    "flowbot3d-md": ("FlowBot3D (MD, ours)", "#e69f00"),
    "oracle": ("oracle", "#222222"),
    "random": ("random", "#999999"),
}
"""Method -> its name in words and its colour; hues that the colour-blind can tell apart.

Ours: networks of this project, under the paper's name of the row."""

TRUTH_COLOUR = "#cc79a7"
"""What is true, or what the paper reports, beside what was measured."""

_OTHERS = ("#f0e442", "#7f3c8d", "#80592b")
_LINES = {
    "SG+CC+HF": "-",
    "SG+CC": (0, (6, 2)),
    "SG+HF": (0, (6, 1.5, 1, 1.5)),
    "SG": (0, (2, 1)),
    "": (0, (1, 3)),
}
_MOST_BYTES = 200_000


def uses_history(method: str) -> bool:
    """Whether the method is given what moved last; unknown methods may."""
    return method not in ("flowbothd-nohistory", "flowbot3d-ro", "flowbot3d-md", "oracle", "random")


def method_label(method: str) -> str:
    """The method in words; unknown ones as they are called."""
    return METHODS[method][0] if method in METHODS else method


def method_colour(method: str) -> str:
    """The method's colour; unknown ones get one of a few others by their name."""
    if method in METHODS:
        return METHODS[method][1]
    return _OTHERS[sum(method.encode()) % len(_OTHERS)]


def row_label(method: str, switches: str) -> str:
    """Method and policy switches in words."""
    return f"{method_label(method)}, {switches}" if switches else method_label(method)


def row_style(method: str, switches: str) -> dict[str, Any]:
    """Line colour by method, line style by switches."""
    return {"color": method_colour(method), "linestyle": _LINES.get(switches, (0, (5, 1)))}


def rows_of(
    records: Iterable[Mapping[str, Any]],
) -> dict[tuple[str, str], list[Mapping[str, Any]]]:
    """Records by (method, switches): methods as in METHODS, then others; full switches first."""
    rows: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for record in records:
        rows.setdefault((str(record["method"]), str(record["switches"])), []).append(record)
    known = list(METHODS)

    def place(row: tuple[str, str]) -> tuple[int, str, int, str]:
        method, switches = row
        first = known.index(method) if method in known else len(known)
        return first, method, -len(switches), switches

    return {row: rows[row] for row in sorted(rows, key=place)}


def fullest(
    rows: Mapping[tuple[str, str], list[Mapping[str, Any]]],
) -> dict[tuple[str, str], list[Mapping[str, Any]]]:
    """Of every method the row with the most switches on."""
    best: dict[str, str] = {}
    for method, switches in rows:
        if len(switches) >= len(best.get(method, "")):
            best[method] = switches
    return {row: own for row, own in rows.items() if best[row[0]] == row[1]}


def tidy(axis: Any) -> None:
    """Grid behind the data, no frame where there is no axis."""
    axis.grid(True, color="0.9", lw=0.8)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)


def save(figure: Figure, path: Path, dpi: int = 110) -> None:
    """Write the figure as a PNG of at most 200 kB and close it.

    Fewer colours first, then fewer pixels, until it fits: the report with all of them is committed.
    """
    try:
        while True:
            data = _png(figure, dpi, None)
            for colours in (256, 96):
                if len(data) > _MOST_BYTES:
                    data = _png(figure, dpi, colours)
            if len(data) <= _MOST_BYTES or dpi <= 50:
                break
            dpi = int(dpi * 0.88)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    finally:
        plt.close(figure)


def _png(figure: Figure, dpi: int, colours: int | None) -> bytes:
    """The figure as PNG, with a palette of so many colours or with all of them."""
    plain = io.BytesIO()
    # Without the writer's version the same figure is the same file under every matplotlib.
    figure.savefig(plain, dpi=dpi, format="png", metadata={"Software": None})
    if colours is None:
        return plain.getvalue()
    with Image.open(plain) as image:
        fewer = image.convert("RGB").quantize(colours, dither=Image.Dither.NONE)
    small = io.BytesIO()
    fewer.save(small, format="png", optimize=True)
    return small.getvalue()
