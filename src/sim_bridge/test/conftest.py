"""Shared material of the tests: the robot, published objects where they are at hand."""

from pathlib import Path

import numpy as np
import pytest

from sim_bridge.objects import load_object

PARTNET = Path(__file__).resolve().parents[4] / "shared" / "data" / "partnet_mobility"


@pytest.fixture(scope="session")
def robot_urdf():
    """The composed robot; belongs to another package, which only tests may import."""
    description = pytest.importorskip("franka_suction_driver.arm.description")
    return description.compose_urdf()


@pytest.fixture(scope="session")
def raw_object():
    """Loads a published object as found, or skips."""

    def load(number):
        folder = PARTNET / "raw" / str(number)
        if not folder.is_dir():
            pytest.skip(f"PartNet-Mobility object {number} is not at hand")
        return load_object(folder)

    return load


@pytest.fixture
def rng():
    """A seeded generator."""
    return np.random.default_rng(7)
