"""Network captures of Velodyne lidars."""
