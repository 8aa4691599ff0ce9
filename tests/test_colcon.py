"""The same sources build and test with colcon, with no ROS sourced."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
pytestmark = [pytest.mark.e2e, pytest.mark.timeout(600)]


def colcon(folder: Path, verb: str, *arguments: str) -> subprocess.CompletedProcess:
    bases = ("--build-base", str(folder / "build"), "--install-base", str(folder / "install"))
    program = str(Path(sys.executable).parent / "colcon")
    return subprocess.run(
        [program, "--log-base", str(folder / "log"), verb, *bases, *arguments],
        cwd=ROOT / "ros2_ws",
        env={**os.environ, "AMENT_PREFIX_PATH": sys.prefix},
        capture_output=True,
        text=True,
        timeout=500,
        check=False,
    )


def installed_config(prefix: Path) -> Path:
    """Where the installed bringup package looks for its simulation's parameters."""
    (library,) = prefix.glob("lib/python3*/site-packages")
    code = "from flowbothd_bringup.node_graph import config_file; print(config_file('sim.yaml'))"
    found = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": str(library)},
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    return Path(found.stdout.strip())


def test_colcon_builds_every_python_package_and_runs_their_tests(tmp_path):
    # Ignored, not skipped: the messages are already in the environment, built against its wheels.
    ignore = ("--packages-ignore", "flowbothd_interfaces")
    built = colcon(tmp_path, "build", *ignore)
    assert built.returncode == 0, built.stdout + built.stderr
    packages = sorted(p.parent.name for p in (ROOT / "src").glob("*/setup.py"))
    for package in packages:
        assert (tmp_path / "install" / package / "share" / package / "package.xml").is_file()
    nodes = {"policy_node": "flowbothd_policy", "inference_node": "flowbothd_policy"}
    for node, package in {**nodes, "oracle_node": "sim_bridge"}.items():
        assert (tmp_path / "install" / package / "lib" / package / node).is_file()
    launch = tmp_path / "install/flowbothd_bringup/share/flowbothd_bringup/launch/sim.launch.py"
    assert launch.is_file()
    assert (tmp_path / "install/flowbothd/lib/flowbothd/flowbothd").is_file()
    config = launch.parent.parent / "config" / "sim.yaml"
    assert config.is_file()
    assert installed_config(tmp_path / "install" / "flowbothd_bringup") == config
    # Two packages suffice: the others' tests run in this very test run already.
    chosen = ("--packages-select", "flowbothd_common", "flowbothd_policy")
    select = ("--pytest-args", "-m", "not ros and not slow")
    tested = colcon(tmp_path, "test", *ignore, *chosen, "--return-code-on-test-failure", *select)
    assert tested.returncode == 0, tested.stdout + tested.stderr
    results = list((tmp_path / "build").glob("*/pytest.xml"))
    assert len(results) == 2 and all('tests="0"' not in r.read_text() for r in results)
