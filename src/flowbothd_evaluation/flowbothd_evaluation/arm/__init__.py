"""The arm in the stepped world: trials over objects, modes and seeds, and their table."""
