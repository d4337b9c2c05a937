"""A wanted accuracy: the elements and steps that reach it, and the error that a run reached."""
