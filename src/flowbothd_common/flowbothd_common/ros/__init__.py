"""Code shared by all nodes: parameters, conversions, liveness, diagnostics, start-up."""
