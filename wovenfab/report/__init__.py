"""Pictures of a run, made from the files in its results directory and nothing else."""
