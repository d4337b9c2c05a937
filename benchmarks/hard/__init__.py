"""The hard cases: where textbook solvers break, run, measured and judged."""
