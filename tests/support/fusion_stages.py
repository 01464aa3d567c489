"""Stages of fusion with the settings that a whole `Config` has for them, as `lidcam/run/build.py` makes them."""

from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.stages.associate import Associate
from lidcam.pipeline.stages.believe import Believe
from lidcam.pipeline.stages.place import Place

CONFIG = Config()


def associate_of(rig: Rig) -> Associate:
    """Association in a rig."""
    return Associate(rig, CONFIG.classes)


def place_of(rig: Rig) -> Place:
    """What cameras alone place in a rig."""
    return Place(rig, CONFIG.fuse, CONFIG.classes, ground_distance_m=CONFIG.combine.ground.distance_m)


def believe_of(rig: Rig, config: Config = CONFIG) -> Believe:
    """Belief in a rig."""
    is_calibrated, has_network = config.detect3d.scores_are_probabilities, config.detect3d.has_network
    motion = config.combine.motion
    return Believe(rig, config.classes, motion, scores_are_probabilities=is_calibrated, has_network=has_network)
