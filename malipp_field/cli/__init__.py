"""The `malipp` command line."""
