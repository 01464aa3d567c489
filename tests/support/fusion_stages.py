"""Stages of fusion with the settings that a whole `Config` has for them, as `lidcam/run/build.py` makes them."""

from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.detectors.cluster.fitting import BoxFitter
from lidcam.pipeline.stages.associate import Associate
from lidcam.pipeline.stages.believe import Believe
from lidcam.pipeline.stages.place import Place
from lidcam.pipeline.stages.propose import Propose
from lidcam.pipeline.stages.reshape import Reshape

CONFIG = Config()


def associate_of(rig: Rig) -> Associate:
    """Association in a rig."""
    return Associate(rig, CONFIG.classes)


def place_of(rig: Rig, config: Config = CONFIG) -> Place:
    """What cameras alone place in a rig."""
    return Place(rig, config.fuse, config.classes, ground_distance_m=config.combine.ground.distance_m)


def propose_of(rig: Rig) -> Propose:
    """Proposals in a rig."""
    classes, settings = CONFIG.classes, CONFIG.detect3d.cluster
    return Propose(rig, BoxFitter(rig, classes, settings), settings, classes)


def reshape_of(rig: Rig, config: Config) -> Reshape:
    """Boxes completed again."""
    return Reshape(BoxFitter(rig, config.classes, config.detect3d.cluster), config.detect3d, config.classes)


def believe_of(rig: Rig, config: Config = CONFIG) -> Believe:
    """Belief in a rig."""
    is_calibrated, has_network = config.detect3d.scores_are_probabilities, config.detect3d.has_network
    motion = config.combine.motion
    return Believe(rig, config.classes, motion, scores_are_probabilities=is_calibrated, has_network=has_network)
