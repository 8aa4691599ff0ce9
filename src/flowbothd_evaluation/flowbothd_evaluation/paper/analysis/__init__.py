"""The paper's analyses that need weights and objects: how predictions behave outside a run."""

ANALYSES = (
    "occlusion",
    "multimodality",
    "doors",
    "history",
    "chains",
    "rollouts",
    "showcases",
    "recorded_clouds",
)
"""Names, in the order of the report; here, so that `--help` need not import what they need."""
