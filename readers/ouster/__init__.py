"""Packets of Ouster lidars, decoded by Ouster's own library."""
