"""Checkpoints of OpenPCDet and mmdetection3d as networks in pillars."""
