"""Data files that rosbag2 compressed as a whole (`--compression-mode file`)."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from pathlib import Path

import zstandard

PACKED = (".zstd", ".zst")


def unpacked(path: Path, problems: list[str]) -> Path:
    """The file itself, or a copy of what is packed in it, which lives as long as the process.

    Of a packed file that is cut off, what can be unpacked is kept, and a problem is noted.
    """
    if path.suffix not in PACKED:
        return path
    target = temporary_copy(path.stem)
    with path.open("rb") as source, target.open("wb") as sink:
        try:
            zstandard.ZstdDecompressor().copy_stream(source, sink)
        except zstandard.ZstdError as error:
            problems.append(f"{path.name} is damaged ({error}); what can be unpacked is used")
    return target


def temporary_copy(name: str) -> Path:
    """Where a file of this name can be put that lives as long as the process."""
    folder = tempfile.mkdtemp(prefix="flowbothd-bag-")
    weakref.finalize(_KEEPER, shutil.rmtree, folder, ignore_errors=True)
    return Path(folder) / name


class _Keeper:
    """Lives until the process ends."""


_KEEPER = _Keeper()
