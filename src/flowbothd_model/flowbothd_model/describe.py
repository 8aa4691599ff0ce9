"""File and hash of a network's weights.

    python -m flowbothd_model.describe compact-doors

prints them as YAML, for those that must not import torch to know them.
"""

from __future__ import annotations

import sys
from pathlib import Path

from flowbothd_common.errors import CheckpointError
from flowbothd_common.plain_yaml import plain_yaml
from flowbothd_model.checkpoint import weights_hash
from flowbothd_model.predictor import find_weights


def describe(model: str) -> dict[str, str]:
    """Return the file and the sha256 of weights, or why they cannot be had."""
    try:
        file = Path(find_weights(model))
        digest = weights_hash(file)
    except (CheckpointError, OSError) as error:
        return {"error": str(error)}
    return {"file": f"{file.parent.name}/{file.name}", "sha256": digest}


if __name__ == "__main__":
    sys.stdout.write(plain_yaml(describe(sys.argv[1])))
