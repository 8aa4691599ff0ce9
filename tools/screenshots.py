"""Takes the pictures of `flowbothd view` and `flowbothd report` that the README shows.

    .venv/bin/flowbothd demo --seed 3
    .venv/bin/python tools/screenshots.py out/demo/bag --to 40

Needs Rerun (`pip install rerun-sdk`), and from the system a virtual screen with software rendering
and a browser: `apt-get install xvfb mesa-vulkan-drivers chromium`.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
IMAGES = ROOT / "docs" / "images"
VIEW_SIZE, VIEW_WIDTH = "1500x950", 1200
REPORT_SIZE = "1150,1500"
TIMEOUT = 300
LARGEST = 490_000


def tool(name: str, hint: str) -> str:
    """Path of a program, or an end with what would give it."""
    found = shutil.which(name) or shutil.which(name, path=str(Path(sys.executable).parent))
    if found is None:
        raise SystemExit(f"{name} is missing: {hint}")
    return found


def command(*words: str, environment: dict[str, str] | None = None) -> None:
    """Run a program to its end."""
    subprocess.run(words, check=True, timeout=TIMEOUT, env=environment, stderr=subprocess.DEVNULL)


def flowbothd(*words: str) -> None:
    """Run a command of this project."""
    command(sys.executable, "-m", "flowbothd.cli", *words)


def shrink(picture: Path, target: Path, width: int) -> None:
    """Write a picture of a width, with fewer colours if it would be too large to keep."""
    image = Image.open(picture).convert("RGB")
    height = round(image.height * width / image.width)
    smaller = image.resize((width, height), Image.Resampling.LANCZOS)
    smaller.save(target, optimize=True)
    if target.stat().st_size > LARGEST:
        smaller.quantize(256).save(target, optimize=True)


def view(bag: Path, begin: str, end: str, folder: Path) -> None:
    """Take a picture of Rerun."""
    rerun = tool("rerun", "pip install rerun-sdk")
    screen = tool("xvfb-run", "apt-get install xvfb mesa-vulkan-drivers")
    span = ("--from", begin, "--to", end)
    flowbothd("view", str(bag), *span, "--save", str(folder / "run.rrd"))
    shot = folder / "view.png"
    command(
        # The pointer rests in the middle of the screen; there it must not touch the window.
        *(screen, "-a", "-s", "-screen 0 4000x3000x24", rerun, str(folder / "run.rrd")),
        *("--screenshot-to", str(shot), "--window-size", VIEW_SIZE),
        # Warnings about software rendering would lie over the picture.
        environment={**os.environ, "XDG_RUNTIME_DIR": str(folder), "RUST_LOG": "error"},
    )
    shrink(shot, IMAGES / "view.png", VIEW_WIDTH)


def report(bag: Path, folder: Path) -> None:
    """Take a picture of the report."""
    browser = tool("chromium", "apt-get install chromium")
    flowbothd("report", str(bag), "--out", str(folder / "report"), "--no-animation")
    shot = folder / "report.png"
    page = (folder / "report" / "report.html").as_uri()
    command(
        *(browser, "--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"),
        *(f"--window-size={REPORT_SIZE}", f"--screenshot={shot}", page),
    )
    shrink(shot, IMAGES / "report.png", 900)


def main() -> None:
    """Write docs/images/view.png and docs/images/report.png."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bag", type=Path)
    parser.add_argument("--from", dest="begin", default="0", help="where the view begins")
    parser.add_argument("--to", default="1e9", help="moment of the view, seconds into the bag")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        view(arguments.bag, arguments.begin, arguments.to, Path(folder))
        report(arguments.bag, Path(folder))


if __name__ == "__main__":
    main()
