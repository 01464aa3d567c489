"""Calibration files of other systems as rig files; the content says which a file is, not its name."""
