"""Give all packages a new version: tools/set_version.py 0.2.0 [repository]."""

from __future__ import annotations

import re
import sys
from pathlib import Path


def set_version(version: str, root: Path) -> None:
    """Write VERSION and the package.xml of every package, from which the builds take theirs."""
    for manifest in sorted(root.glob("src/*/package.xml")):
        text = manifest.read_text()
        manifest.write_text(re.sub(r"<version>.*</version>", f"<version>{version}</version>", text))
    (root / "VERSION").write_text(version + "\n")


def main(arguments: list[str]) -> int:
    """Run the command; 2 if the version is not MAJOR.MINOR.PATCH."""
    if not arguments or not re.fullmatch(r"\d+\.\d+\.\d+", arguments[0]):
        sys.stderr.write("usage: tools/set_version.py MAJOR.MINOR.PATCH [repository]\n")
        return 2
    root = Path(arguments[1]) if arguments[1:] else Path(__file__).resolve().parent.parent
    set_version(arguments[0], root)
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
