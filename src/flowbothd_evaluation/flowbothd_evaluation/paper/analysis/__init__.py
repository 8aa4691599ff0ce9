"""The paper's analyses that need weights and objects: how predictions behave outside a run."""
