"""A target accuracy: elements and steps that reach it, and the estimated error of a run."""
