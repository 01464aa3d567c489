"""A simulator of recordings: lidars, cameras and traffic."""
