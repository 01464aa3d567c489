"""The 3D engines: what `detect3d.method` can name, one row each."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Engine3D:
    """A source of the 3D boxes of a frame."""

    # `module:name` of what makes the engine, a `lidcam.pipeline.detectors.protocols.Detector3D`, from rig and settings;
    # imported where it is used. Empty: nothing looks at the cloud
    maker: str
    words: str  # Where the boxes come from, for tables
    # Whether a score is the probability that there is an object. Other scores are calibrated by
    # `lidcam.pipeline.fusion.belief`
    scores_are_probabilities: bool = True
    # Whether boxes are what is seen, completed to the size of their class, so that a box whose class changes is
    # completed anew
    boxes_are_completed: bool = False


ENGINES: dict[str, Engine3D] = {
    "cluster": Engine3D(
        "lidcam.pipeline.detectors.cluster.detector:ClusterDetector",
        "clustering",
        scores_are_probabilities=False,
        boxes_are_completed=True,
    ),
    "pillars": Engine3D("lidcam.pipeline.detectors.pillars.detector:FittedPillarDetector", "network"),
    "combined": Engine3D(
        "lidcam.pipeline.detectors.combined:CombinedDetector", "network and clustering", boxes_are_completed=True
    ),
    "recorded": Engine3D("", "recorded"),
    "callable": Engine3D("", "by a function of the caller"),
    "none": Engine3D("", "none: detect3d.method is none"),
}
"""By name. An engine with settings has a section of its name in `Detect3DConfig`."""
