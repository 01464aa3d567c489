"""The truth that results are compared with: recorded topics, odometry, label files."""
