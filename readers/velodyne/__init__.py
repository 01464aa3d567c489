"""Packets of Velodyne lidars to sweeps."""
