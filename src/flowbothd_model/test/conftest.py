"""Fixtures shared by several tests."""

from pathlib import Path

import pytest
import torch


@pytest.fixture(scope="session")
def partnet_root() -> Path:
    """The reduced PartNet-Mobility objects beside the repository."""
    root = Path(__file__).resolve().parents[3].parent / "shared" / "data" / "partnet_mobility"
    if not (root / "train").is_dir():
        pytest.skip("no PartNet-Mobility data at ../shared/data")
    return root


@pytest.fixture(autouse=True)
def _one_thread():
    """Small tensors on few, busy cores: threads only wait for each other."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
