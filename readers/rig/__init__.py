"""The rig: found in a recording, read from a file, written to one."""
