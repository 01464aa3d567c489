"""Running a scenario, and writing its messages and ground truth to files."""
