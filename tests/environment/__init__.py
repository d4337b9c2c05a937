"""Helpers for the tests of env/enter."""
