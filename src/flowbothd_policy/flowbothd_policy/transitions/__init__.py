"""Transitions of the policy: what each event changes and which commands it gives."""
