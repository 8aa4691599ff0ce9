"""Reports of runs: what happened, as pictures, signals and a summary."""
