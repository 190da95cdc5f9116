"""The REST routes, one file a concern."""
