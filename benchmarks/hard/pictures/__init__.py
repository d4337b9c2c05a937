"""A picture for each family of hard cases."""
