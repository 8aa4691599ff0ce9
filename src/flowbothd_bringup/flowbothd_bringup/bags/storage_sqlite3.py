"""sqlite3 data files, as rosbag2 wrote them by default before Iron."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path

from flowbothd_bringup.bags.metadata import BagError, Topic, parse_qos


class SqliteStorage:
    """One sqlite3 file, read only.

    Args:
        path: The file.

    Raises:
        BagError: this is no rosbag2 database.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.topics: dict[str, Topic] = {}
        self.problems: list[str] = []
        self._names: dict[int, str] = {}
        try:
            with self._connect() as database:
                self._read_topics(database)
        except sqlite3.Error as error:
            raise BagError(
                f"{path} is not a readable rosbag2 database",
                got=error,
                hint="cut off? `sqlite3 FILE .recover` may save what is left",
            ) from error

    def _connect(self) -> sqlite3.Connection:
        # The journal of a writer that was killed is applied if the folder allows it.
        journal = self._path.with_name(self._path.name + "-wal").exists()
        mode = "mode=ro" if journal else "mode=ro&immutable=1"
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
            with self._connect() as database:
                return {self._names[number]: count for number, count in database.execute(query)}
        except sqlite3.Error as error:
            self._damaged(error)
            return {}

    def messages(self, topics: frozenset[str]) -> Iterator[tuple[str, int, bytes]]:
        """Topic, receive time and content of every message of the topics, in time order."""
        numbers = [n for n, name in self._names.items() if name in topics]
        marks = ", ".join("?" * len(numbers))
        query = (
            f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks}) "
            "ORDER BY timestamp, id"
        )
        try:
            with self._connect() as database:
                for number, time, data in database.execute(query, numbers):
                    yield self._names[number], time, data
        except sqlite3.Error as error:
            self._damaged(error)

    def _damaged(self, error: sqlite3.Error) -> None:
        text = f"{self._path.name} is damaged ({error}); read up to there"
        if text not in self.problems:
            self.problems.append(text)

    def attachments(self) -> dict[str, bytes]:
        """None: the format has no place for files."""
        return {}
