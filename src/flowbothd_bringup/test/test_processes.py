"""Processes of a graph are started, watched and stopped together."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

RUNNER = """
import os, sys
from flowbothd_bringup.processes import NodeProcess, run_graph
commands = eval(sys.argv[1])
processes = [NodeProcess(name, tuple(command), required) for name, command, required in commands]
sys.exit(run_graph(processes, dict(os.environ)))
"""
SLEEP = [sys.executable, "-c", "import time; time.sleep(120)"]
STUBBORN = [
    sys.executable,
    "-c",
    "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); time.sleep(120)",
]


def start(commands) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-c", RUNNER, repr(commands)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def descendants(process: subprocess.Popen, count: int) -> list[psutil.Process]:
    """Children that sleep, once there are `count`; bounded wait."""
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline:
        children = [
            c for c in psutil.Process(process.pid).children(recursive=True) if "sleep" in cmdline(c)
        ]
        if len(children) >= count:
            return children
        time.sleep(0.05)
    raise AssertionError("the processes did not start")


def cmdline(process: psutil.Process) -> str:
    try:
        arguments = process.cmdline()
    except psutil.Error:
        return ""
    return " ".join(arguments) if "run_graph" not in " ".join(arguments) else ""


def assert_gone(processes: list[psutil.Process]) -> None:
    _, alive = psutil.wait_procs(processes, timeout=15)
    assert not alive


def test_the_graph_ends_with_its_required_process_and_takes_its_status():
    graph = start(
        [
            ("other", SLEEP, False),
            ("operator", [sys.executable, "-c", "import sys; sys.exit(7)"], True),
        ]
    )
    output, _ = graph.communicate(timeout=60)
    assert graph.returncode == 7, output
    assert "operator" in output


def test_what_is_not_required_does_not_decide_the_status():
    """A recorder that had failed made `flowbothd demo` say "not opened" of an open door."""
    late = "import sys, time; time.sleep(1.5); sys.exit(7)"
    graph = start(
        [
            ("recorder", [sys.executable, "-c", "import sys; sys.exit(1)"], False),
            ("operator", [sys.executable, "-c", late], True),
        ]
    )
    output, _ = graph.communicate(timeout=60)
    assert graph.returncode == 7, output


def test_a_dead_node_leaves_the_others_running():
    """Honcho alone would stop all of them, and nobody could see the arm hold."""
    graph = start([("a", SLEEP, False), ("b", SLEEP, False)])
    first, second = descendants(graph, 2)
    first.kill()
    assert_gone([first])
    with pytest.raises(subprocess.TimeoutExpired):
        graph.wait(timeout=1.0)
    assert second.is_running()
    graph.send_signal(signal.SIGINT)
    output, _ = graph.communicate(timeout=60)
    assert "stopped" in output
    assert_gone([second])


def test_ctrl_c_leaves_nothing_behind_not_even_who_ignores_it():
    graph = start([("a", SLEEP, False), ("stubborn", STUBBORN, False)])
    children = descendants(graph, 2)
    graph.send_signal(signal.SIGINT)
    graph.communicate(timeout=60)
    assert graph.returncode == 130
    assert_gone(children)


def test_a_node_follows_its_guardian_after_sigkill(tmp_path: Path):
    """The incident: a killed command line left six nodes, and the next run met them."""
    code = "import time; from flowbothd_common.parent_watch import watch_parent;"
    code += "watch_parent(); print('watching', flush=True); time.sleep(120)"
    guardian = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(120)"])
    node = subprocess.Popen(
        [sys.executable, "-c", code],
        env={**os.environ, "FLOWBOTHD_PARENT_PID": str(guardian.pid)},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert node.stdout.readline().strip() == "watching"
    guardian.kill()
    guardian.wait(timeout=10)
    assert node.wait(timeout=10) == -signal.SIGTERM


def test_ctrl_c_while_processes_are_being_started_leaves_nothing_behind():
    """The incident: honcho's own handler raised KeyError 'pid', and the command line hung."""
    graph = start([(f"node{i}", SLEEP, False) for i in range(6)])
    children = descendants(graph, 1)
    graph.send_signal(signal.SIGINT)
    graph.communicate(timeout=60)
    assert graph.returncode == 130
    assert_gone(children)
