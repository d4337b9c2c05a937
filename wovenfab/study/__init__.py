"""Studies: the same case many times over, with one thing changed."""
