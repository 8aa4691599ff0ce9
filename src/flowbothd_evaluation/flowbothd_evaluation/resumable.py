"""Many independent pieces of work, one JSON record each; killed and started again, it goes on."""

from __future__ import annotations

import argparse
import fcntl
import json
import multiprocessing
import os
import signal
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from tqdm import tqdm

from flowbothd_common.errors import ParameterError
from flowbothd_common.parent_watch import PARENT_PID, watch_parent
from flowbothd_evaluation.run_record.record import as_plain

Record = dict[str, Any]
Work = TypeVar("Work")
Key = TypeVar("Key", bound=Hashable)


def add_work_arguments(parser: argparse.ArgumentParser, out: Path, unit: str = "trial") -> None:
    """`--jobs` and `--out` of a command that runs resumable work."""
    parser.add_argument("--jobs", type=int, default=2, help="processes (default: %(default)s)")
    parser.add_argument(
        "--out",
        type=Path,
        default=out,
        help=f"one record a {unit}; run again, it continues (default: %(default)s)",
    )


def read_records(path: Path) -> list[Record]:
    """Complete records of a file, which may have been cut off in its last line.

    Raises:
        ParameterError: a complete line is no JSON object: the file is something else.
    """
    if not path.exists():
        return []
    records = []
    for number, line in enumerate(path.read_bytes().split(b"\n")[:-1], start=1):
        try:
            record = json.loads(line)
        except ValueError:
            record = None
        if not isinstance(record, dict):
            raise ParameterError(
                f"line {number} of {path} is no record",
                got=line[:60].decode(errors="replace"),
                hint="give the file that an evaluation wrote, or another name to write to",
            )
        records.append(record)
    return records


def run_resumable(
    work: Mapping[Key, Work],
    run: Callable[[Work], Record],
    key: Callable[[Record], Key],
    out: Path,
    jobs: int,
    *,
    unit: str = "trial",
) -> list[Record]:
    """Do the work that `out` has no record of yet, append the records, return those of the work.

    A record is one line, written at once when its work is done; whatever else the file holds
    stays. Every piece is worked on in a process of its own, so that `jobs` changes nothing but
    the order of the lines.

    Args:
        work: What there is to do, by key.
        run: Does one piece, in another process; must not fail.
        key: Of a record; equals that of its work.
        out: JSON lines.
        jobs: Processes.
        unit: What one piece is called in the progress bar.

    Returns:
        Records in the order of `work`.

    Raises:
        ParameterError: `jobs` is not positive, another command writes to `out`, or `out` is no file
            of records.
    """
    if jobs < 1:
        raise ParameterError("number of processes", got=jobs, allowed=">= 1")
    out.parent.mkdir(parents=True, exist_ok=True)
    with _locked(out) as file:
        found = {key(record): record for record in read_records(out)}
        missing = [piece for name, piece in work.items() if name not in found]
        with tqdm(total=len(work), initial=len(work) - len(missing), unit=unit) as bar:
            for record in _done(missing, run, jobs):
                file.write(json.dumps(record).encode() + b"\n")
                found[key(record)] = record
                bar.update()
    return [found[name] for name in work]


def _done(missing: Sequence[Work], run: Callable[[Work], Record], jobs: int) -> Iterator[Record]:
    """Records as they come."""
    if not missing:
        return
    pool = ProcessPoolExecutor(
        min(jobs, len(missing)),
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_follow,
        initargs=(os.getpid(),),
    )
    try:
        for future in as_completed([pool.submit(run, piece) for piece in missing]):
            yield as_plain(future.result())
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def _locked(path: Path) -> Iterator[Any]:
    """The file for appending, unbuffered, without a last line that was cut off; ours alone."""
    with path.open("ab", buffering=0) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise ParameterError(
                "another command is writing its records",
                got=path,
                hint="wait, or give another file",
            ) from error
        whole = path.read_bytes().rfind(b"\n") + 1
        file.truncate(whole)
        yield file


def _follow(pid: int) -> None:
    """Make a worker end with the command line, which may be killed in the middle of a trial."""
    # Ctrl-C goes to all of the group; what a worker has begun it may end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ[PARENT_PID] = str(pid)
    watch_parent()
