"""Everything of a run to look at, live or from a recording, in Rerun."""
