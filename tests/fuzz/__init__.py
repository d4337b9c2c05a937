"""Mutated cases."""
