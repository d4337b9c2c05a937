"""What a run leaves on disk: history, fields and summary in a results directory."""
