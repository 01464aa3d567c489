"""Frames shared among processes, to get around the interpreter's lock, with the results of one process."""
