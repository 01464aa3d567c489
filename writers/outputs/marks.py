"""By what lidcam knows its own files: a run replaces those of earlier runs, and no others."""

__all__ = ["APPLICATION", "BAG_CALLER", "FOLDER_DATA", "INPUTS", "LIBRARY", "MERGED", "REPAIRED", "RESULT", "SIMULATED"]

LIBRARY = "lidcam"
"""In the header of an MCAP. Without a version: the same results have the same bytes whichever version of the MCAP
library wrote them."""

RESULT = "lidcam"
REPAIRED = "lidcam.repair"
SIMULATED = "lidcam_truth"
MERGED = "lidcam.merged"
"""Names of metadata records of an MCAP: a result, a repaired recording, a simulated one, two results side by side."""

INPUTS = "lidcam.inputs"
"""Of a result: what is known of its inputs when all of them were read."""

APPLICATION = "lidcam"
"""Application of an .rrd."""

BAG_CALLER = "/lidcam_simulator"
"""The node that publishes all topics of a simulated ROS 1 bag."""

FOLDER_DATA = {"lidcam": "simulated"}
"""Custom data of a simulated ROS 2 bag folder."""
