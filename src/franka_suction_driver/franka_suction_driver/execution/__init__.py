"""Running motions: guarded steps, tool paths, the envelope that holds them."""
