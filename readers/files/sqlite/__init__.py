"""The sqlite3 files of ROS 2 bags."""
