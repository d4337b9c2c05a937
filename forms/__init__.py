"""The physics of a woven sheet in UFL: symbols only, no mesh and no solver."""
