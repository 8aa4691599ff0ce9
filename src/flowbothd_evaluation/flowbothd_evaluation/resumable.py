"""Many independent pieces of work, one record each; killed and started again, it goes on."""

from __future__ import annotations

import argparse
import fcntl
import multiprocessing
import os
import signal
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, TypeVar

from tqdm import tqdm

from flowbothd_common.errors import ParameterError
from flowbothd_common.parent_watch import PARENT_PID, watch_parent
from flowbothd_evaluation.record_files import R, from_json, read_records, to_json

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


def run_resumable(
    work: Mapping[Key, Work],
    run: Callable[[Work], R],
    kind: type[R],
    out: Path,
    jobs: int,
    *,
    unit: str = "trial",
) -> list[R]:
    """Do the work that `out` has no record of yet, append the records, return those of the work.

    A record is one line, written at once when its work is done; whatever else the file holds
    stays. Every piece is worked on in a process of its own, so that `jobs` changes nothing but
    the order of the lines.

    Args:
        work: What there is to do, by the key that its record will have.
        run: Does one piece, in another process; must not fail.
        kind: Of the records; those in the file may be of an earlier version.
        out: JSON lines.
        jobs: Processes.
        unit: Name of one piece in the progress bar.

    Returns:
        Records in the order of `work`.

    Raises:
        ParameterError: `jobs` is not positive, another command writes to `out`, or `out` is no file
            of such records.
    """
    if jobs < 1:
        raise ParameterError("number of processes", got=jobs, allowed=">= 1")
    out.parent.mkdir(parents=True, exist_ok=True)
    with _locked(out) as file:
        found: dict[Hashable, R] = {record.key: record for record in read_records(out, kind)}
        missing = [piece for name, piece in work.items() if name not in found]
        with tqdm(total=len(work), initial=len(work) - len(missing), unit=unit) as bar:
            for done in _done(missing, run, jobs):
                line = to_json(done)
                file.write(line.encode() + b"\n")
                # As the next run will read it, so that both return the same.
                record = from_json(kind, line, str(out))
                found[record.key] = record
                bar.update()
    return [found[name] for name in work]


def _done(missing: Sequence[Work], run: Callable[[Work], R], jobs: int) -> Iterator[R]:
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
            yield future.result()
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def _locked(path: Path) -> Iterator[BinaryIO]:
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
