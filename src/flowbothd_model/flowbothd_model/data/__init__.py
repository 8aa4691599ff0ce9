"""Endless, seeded training data: articulated objects, a ray caster, and ground-truth flow."""
