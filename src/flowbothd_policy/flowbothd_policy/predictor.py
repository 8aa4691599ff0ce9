"""Interface of the predictors of articulation flow."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from flowbothd_common.types import Cloud, History


@runtime_checkable
class FlowPredictor(Protocol):
    """Samples flow fields for a cloud: a network, an oracle, or a recording.

    Attributes:
        model_id: Name that decisions and reports show.
    """

    model_id: str

    def sample(
        self,
        points: Cloud,
        history: History | None = None,
        samples: int = 1,
        steps: int | None = None,
        sampler: str | None = None,
        seed: int | None = None,
    ) -> NDArray[np.float32]:
        """Draw flow fields.

        Args:
            points: (N, 3) float32, base frame [m].
            history: What moved last, or None.
            samples: S, how many fields.
            steps: Denoising steps; None = the predictor's own; ignored where there are none.
            sampler: Name of the sampler; None = the predictor's own.
            seed: Same seed, same samples; None = not reproducible.

        Returns:
            (S, N, 3) float32, each field max-normalised: its largest norm is 1, or 0 if nothing
            moves.
        """
        ...
