import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from detections import forward_camera
from frames import RIG, frame

from lidcam.pipeline.core.rig import Rig
from lidcam.writers.foxglove.layout import foxglove_layout
from lidcam.writers.viewpoint import SceneSurvey

SITE = {"/point_cloud_combined", "/ground_cloud", "/fused/scene", "/fused/markers", "/diagnostics", "/tf_static"}
CAMERAS = {f"/{name}/{leaf}" for name in ("left", "right") for leaf in ("camera_info", "annotations")}
TOPICS = SITE | CAMERAS | {"/left/image", "/right/image/compressed"}


def surveyed(rig: Rig = RIG) -> SceneSurvey:
    survey = SceneSurvey(rig)
    survey.add_frame(frame())
    return survey


def layout(topics: set[str], *, rig: Rig = RIG) -> Any:
    return json.loads(foxglove_layout(rig, surveyed(rig), topics))


def leaves(node: Any) -> list[str]:
    """Ids of the panels of a tree of splits; asserts the form of each split."""
    if isinstance(node, str):
        return [node]
    assert set(node) == {"first", "second", "direction", "splitPercentage"}
    assert node["direction"] in ("row", "column")
    assert 0 < node["splitPercentage"] < 100
    return leaves(node["first"]) + leaves(node["second"])


def named_topics(node: Any) -> set[str]:
    """Every string in a layout that begins like a topic, without the path into its messages."""
    if isinstance(node, dict):
        return set().union(*(named_topics(part) for pair in node.items() for part in pair))
    if isinstance(node, list):
        return set().union(*map(named_topics, node))
    return {node.split(".")[0]} if isinstance(node, str) and node.startswith("/") else set()


@pytest.mark.parametrize(
    "topics", [TOPICS, SITE, TOPICS - {"/left/image", "/ground_cloud", "/right/annotations"}, {"/diagnostics"}]
)
def test_every_panel_has_its_place_and_every_topic_exists(topics: set[str]) -> None:
    found = layout(topics)
    assert set(found) == {"lidcam", "configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    panels = leaves(found["layout"])
    assert len(set(panels)) == len(panels)
    assert set(panels) == set(found["configById"])
    assert {panel.split("!")[0] for panel in panels} <= {"3D", "Image", "Plot", "DiagnosticSummary"}
    assert named_topics(found) <= topics


def test_everything_is_switched_on_once() -> None:
    configs = layout(TOPICS)["configById"]
    shown = {topic: settings["visible"] for topic, settings in configs["3D!scene"]["topics"].items()}
    frusta = {"/left/camera_info": True, "/right/camera_info": True}
    clouds = {"/point_cloud_combined": True, "/ground_cloud": True}
    assert shown == {**clouds, **frusta, "/fused/scene": True, "/fused/markers": False}
    assert configs["3D!scene"]["followTf"] == "site"
    for name, topic in (("left", "/left/image"), ("right", "/right/image/compressed")):
        assert configs[f"Image!{name}"]["imageMode"] == {
            "imageTopic": topic,
            "synchronize": False,
            "calibrationTopic": f"/{name}/camera_info",
            "annotations": {f"/{name}/annotations": {"visible": True}},
        }


def test_the_eye_is_that_of_the_viewpoint() -> None:
    """As the panel computes it (CameraStateSettings): three.js' spherical angles, turned about x by 90 degrees."""
    state = layout(SITE)["configById"]["3D!scene"]["cameraState"]
    phi, theta = np.radians(state["phi"]), -np.radians(state["thetaOffset"])
    x, y, z = np.sin(phi) * np.sin(theta), np.cos(phi), np.sin(phi) * np.cos(theta)
    eye = np.array([x, -z, y]) * state["distance"] + state["targetOffset"]
    expected = surveyed().viewpoint(aspect=0.58 * 1600 / 896 / 0.73, fov_y_deg=45)
    np.testing.assert_allclose(eye, expected.eye, atol=0.05)
    np.testing.assert_allclose(state["targetOffset"], expected.target, atol=1e-3)


def test_wide_images_are_above_the_scene() -> None:
    wide = replace(RIG, cameras=(forward_camera("left", size_px=(1242, 375)),))
    tree = layout(TOPICS, rig=wide)["layout"]
    assert (tree["direction"], tree["first"]) == ("column", "Image!left")
    assert tree["second"]["first"]["first"] == "3D!scene"


def test_from_above_the_way_that_is_up_is_up() -> None:
    """As the panel computes it: the orthographic eye is turned about z by minus the angle, x right and y up before."""
    config = layout(TOPICS)["configById"]["3D!above"]
    assert not config["cameraState"]["perspective"]
    assert not config["topics"]["/left/camera_info"]["visible"]
    theta = -np.radians(config["cameraState"]["thetaOffset"])
    up = np.array([-np.sin(theta), np.cos(theta)])
    x = np.array([1.0, 0.0])  # the cameras look along x; what they see may also lie to the right
    assert max(up @ x, up @ [0.0, 1.0]) == pytest.approx(1.0)
