"""The figures and claims of the paper, computed anew with parameters that are stated."""
