"""Whether the calibration of a run can be right."""
