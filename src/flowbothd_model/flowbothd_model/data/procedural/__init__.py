"""Articulated objects made by rule, for all 21 categories of the paper; front towards -x, z up."""
