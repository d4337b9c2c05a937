"""Work and precision: what accuracy costs, by runs that vary mesh, degree, steps and scheme."""
