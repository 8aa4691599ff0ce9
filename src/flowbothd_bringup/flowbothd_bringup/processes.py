"""Starts, watches and stops the processes of one graph together, by honcho."""

from __future__ import annotations

import shlex
from collections.abc import Sequence

from honcho.manager import Manager

from flowbothd_bringup.node_graph import NodeProcess


class _Graph(Manager):
    """A honcho manager in which only required processes take the others with them.

    honcho stops everything when anything stops. A robot's nodes must not: when one dies, the
    others hold the arm and say what is missing, and that can be seen only while they run.
    """

    def __init__(self, required: frozenset[str]) -> None:
        super().__init__()
        self._required = required
        self._ending = False

    def terminate(self) -> None:
        """Stop all processes; those that are just being started, as soon as they have a pid.

        A signal may come while honcho does not know every pid yet. Its own terminate would then
        raise, and leave behind what has been started.
        """
        self._ending = True
        if self._all_started():
            super().terminate()

    def _any_stopped(self) -> bool:
        codes = {name: p.get("returncode") for name, p in self._processes.items()}
        ended = [codes[name] for name in self._required if codes[name] is not None]
        if ended and not self._ending:
            # honcho keeps the status of whichever ended first, be it only a recorder.
            self.returncode = ended[0]
        return self._ending or bool(ended)


def run_graph(processes: Sequence[NodeProcess], environment: dict[str, str]) -> int:
    """Run the processes until a required one ends, all have ended, or SIGINT or SIGTERM comes.

    Processes that do not stop on SIGTERM within five seconds are killed.

    Returns:
        The exit status of the required process that ended first, otherwise of any; 130 / 143 after
        a signal.
    """
    graph = _Graph(frozenset(p.name for p in processes if p.required))
    for process in processes:
        # exec: signals then reach the node itself and no shell in between.
        graph.add_process(process.name, "exec " + shlex.join(process.command), env=environment)
    graph.loop()
    # Of the process that stopped first, unless a signal came before: the cause, not a consequence.
    return int(graph.returncode or 0)
