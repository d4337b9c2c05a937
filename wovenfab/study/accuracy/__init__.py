"""Work and precision: the cost of accuracy, by runs that vary mesh, degree, steps and scheme."""
