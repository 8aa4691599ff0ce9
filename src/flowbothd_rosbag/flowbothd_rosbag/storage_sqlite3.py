"""sqlite3 data files, as rosbag2 wrote them by default before Iron."""

from __future__ import annotations

import shutil
import sqlite3
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from flowbothd_rosbag.metadata import BagError, Topic, parse_qos
from flowbothd_rosbag.unpack import temporary_copy

_HEADER = 100
"""Bytes of a database's header: sizes of pages at 16, how many at 28."""


class SqliteStorage:
    """One sqlite3 file, read only.

    Args:
        path: The file.

    Raises:
        BagError: this is no rosbag2 database.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._cut = path, False
        self.topics: dict[str, Topic] = {}
        self.problems: list[str] = []
        self._names: dict[int, str] = {}
        page, whole = _sizes(path)
        missing = whole - path.stat().st_size
        if missing > 0 and not self._journal:
            # sqlite opens nothing that is shorter than its header says.
            self._path, self._cut = _lengthened(path, page, whole), True
            self.problems.append(
                f"{path.name} is cut off ({missing / 1e6:.1f} MB are missing); read up to there"
            )
        try:
            with closing(self._connect()) as database:
                self._read_topics(database)
        except sqlite3.Error as error:
            raise BagError(
                f"{path} is not a readable rosbag2 database",
                got=error,
                hint="cut off? `sqlite3 FILE .recover` may save what is left",
            ) from error

    @property
    def _journal(self) -> bool:
        return self._path.with_name(self._path.name + "-wal").exists()

    def _connect(self) -> sqlite3.Connection:
        # The journal of a writer that was killed is applied if the folder allows it.
        mode = "mode=ro" if self._journal else "mode=ro&immutable=1"
        return sqlite3.connect(f"{self._path.absolute().as_uri()}?{mode}", uri=True)

    def _read_topics(self, database: sqlite3.Connection) -> None:
        columns = {row[1] for row in database.execute("PRAGMA table_info(topics)")}
        wanted = ["id", "name", "type", "serialization_format"]
        if not set(wanted) <= columns:
            raise sqlite3.DatabaseError("it has no table of topics")
        extra = [c for c in ("offered_qos_profiles", "type_description_hash") if c in columns]
        query = f"SELECT {', '.join(wanted + extra)} FROM topics"
        for number, name, kind, encoding, *rest in database.execute(query):
            more = dict(zip(extra, rest, strict=True))
            self._names[number] = name
            self.topics[name] = Topic(
                name,
                kind,
                parse_qos(more.get("offered_qos_profiles", "")),
                more.get("type_description_hash") or "",
                encoding,
            )

    @property
    def counts(self) -> dict[str, int]:
        """Messages by topic."""
        query = "SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id"
        try:
            with closing(self._connect()) as database:
                return {self._names[number]: count for number, count in database.execute(query)}
        except sqlite3.Error:
            return dict(Counter(name for name, _, _ in self.messages(frozenset(self.topics))))

    def messages(self, topics: frozenset[str]) -> Iterator[tuple[str, int, bytes]]:
        """Topic, receive time and content of every message of the topics, in time order.

        Of a file that is cut off they come in the order in which they were written: the index of
        times lies at its end.
        """
        numbers = [n for n, name in self._names.items() if name in topics]
        marks = ", ".join("?" * len(numbers))
        source, order = "messages", "timestamp, id"
        if self._cut:
            source, order = "messages NOT INDEXED", "id"
        query = (
            f"SELECT topic_id, timestamp, data FROM {source} WHERE topic_id IN ({marks}) "
            f"ORDER BY {order}"
        )
        try:
            with closing(self._connect()) as database:
                for number, time, data in database.execute(query, numbers):
                    yield self._names[number], time, data
        except sqlite3.Error as error:
            self._damaged(error)

    def _damaged(self, error: sqlite3.Error) -> None:
        if self._cut:
            return
        text = f"{self._path.name} is damaged ({error}); read up to there"
        if text not in self.problems:
            self.problems.append(text)

    def attachments(self) -> dict[str, bytes]:
        """None: the format has no place for files."""
        return {}


def _sizes(path: Path) -> tuple[int, int]:
    """Bytes of a page and of the whole database, as its header says; zeros if it does not."""
    with path.open("rb") as file:
        header = file.read(_HEADER)
    # The number of pages is valid only if it was written with the last change.
    if not header.startswith(b"SQLite format 3") or header[24:28] != header[92:96]:
        return 0, 0
    page = int.from_bytes(header[16:18], "big")
    page = 65536 if page == 1 else page
    return page, page * int.from_bytes(header[28:32], "big")


def _lengthened(path: Path, page: int, whole: int) -> Path:
    """A copy with zeros where the rest was: reading stops at the first page that is not there."""
    copy = temporary_copy(path.name)
    shutil.copyfile(path, copy)
    with copy.open("r+b") as file:
        # Of half a page some rows would be zeros, and seem to have never been.
        file.truncate(path.stat().st_size // page * page)
        file.truncate(whole)
    return copy
