"""Set-up finds a Python that can build the environment, or says that there is none."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parent.parent / "tools" / "find_python.sh"
VERSION = f"{sys.version_info.major}.{sys.version_info.minor}"


def write_program(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return path


@pytest.fixture
def find(tmp_path):
    """Run the script with nothing but tmp_path/bin in the path and managers under tmp_path."""
    (tmp_path / "bin").mkdir()

    def run(*versions: str) -> subprocess.CompletedProcess:
        return subprocess.run(
            [shutil.which("bash"), str(SCRIPT), *versions],
            cwd=tmp_path,
            env={"PATH": str(tmp_path / "bin"), "HOME": str(tmp_path)},
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )

    return run


def works(path: Path) -> Path:
    return write_program(path, f'exec "{sys.executable}" "$@"')


def fails_as_a_shim(path: Path) -> Path:
    return write_program(path, "echo 'pyenv: command not found' >&2; exit 127")


def test_a_python_in_the_path_is_taken(find, tmp_path):
    python = works(tmp_path / "bin" / f"python{VERSION}")
    assert find(VERSION).stdout.strip() == str(python)


@pytest.mark.parametrize(
    "folder", [".pyenv/versions", ".asdf/installs/python", ".local/share/mise/installs/python"]
)
def test_a_shim_that_runs_nothing_is_passed_over(find, tmp_path, folder):
    """The incident: a manager's shim failed for want of a chosen version, and set-up gave up."""
    fails_as_a_shim(tmp_path / "bin" / f"python{VERSION}")
    python = works(tmp_path / folder / f"{VERSION}.4" / "bin" / f"python{VERSION}")
    found = find(VERSION)
    assert (found.returncode, found.stdout.strip()) == (0, str(python))


def test_the_first_version_that_exists_is_taken(find, tmp_path):
    python = works(tmp_path / "bin" / f"python{VERSION}")
    assert find("3.99", VERSION).stdout.strip() == str(python)


def test_a_python_of_another_version_is_not_taken(find, tmp_path):
    """A link of the wrong name would otherwise build an environment that no lock was made for."""
    works(tmp_path / "bin" / "python3.99")
    found = find("3.99")
    assert (found.returncode, found.stdout) == (1, "")


def test_without_any_it_fails_silently(find, tmp_path):
    fails_as_a_shim(tmp_path / "bin" / f"python{VERSION}")
    found = find(VERSION)
    assert (found.returncode, found.stdout, found.stderr) == (1, "", "")
