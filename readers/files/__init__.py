"""Containers: what a recording is stored in, from a file to a server."""
