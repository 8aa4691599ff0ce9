"""Hash of a network's weights, found in a process of its own: finding them imports torch."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from typing import Any

import yaml

from flowbothd_common.plain_yaml import plain_yaml

_TIMEOUT = 120.0


def models_in_use(parameters: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """Node -> path of the weights, for every node that predicts with a network."""
    return {
        node: str(given["model_path"])
        for node, given in parameters.items()
        if given.get("model_path")
    }


def describe_later(models: Mapping[str, str], done: Callable[[str], None]) -> None:
    """Describe weights without holding up the caller.

    Args:
        models: Node -> weights.
        done: Takes the YAML text, on a thread of its own.
    """

    def work() -> None:
        result = {}
        for node, model in models.items():
            command = [sys.executable, "-m", "flowbothd_model.describe", model]
            try:
                found = subprocess.run(
                    command, capture_output=True, text=True, timeout=_TIMEOUT, check=True
                )
                result[node] = {"model_path": model, **yaml.safe_load(found.stdout)}
            except (subprocess.SubprocessError, OSError) as error:
                result[node] = {"model_path": model, "error": str(error)}
        done(plain_yaml(result, sort_keys=True))

    threading.Thread(target=work, name="weights", daemon=True).start()
