"""From a validated case to a run: everything below is put together here."""
