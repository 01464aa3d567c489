from collections.abc import Iterable
from typing import Any

import cv2
import numpy as np
import pytest
import velodyne
from builders import Fields, header, raw, tf_message, transform_stamped
from rig_messages import K, boxes_2d, cloud, discover, image_message, info, reasons, static

from lidcam.pipeline.core.errors import CalibrationError, RecordingError
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.readers.rig.discovery import Discovery
from lidcam.readers.rig.sensor_topics import SensorFault, faults_told
from lidcam.readers.rig.undecoded import UNDECODED

OPTICAL = (-0.5, 0.5, -0.5, 0.5)  # REP 103: optical axes in a body frame


def compressed(topic: str, frame: str, encoding: str = "rgb8") -> RawMessage:
    data = cv2.imencode(".png", np.zeros((48, 64), np.uint8))[1].reshape(-1)
    fields = {"header": header(5, frame), "format": f"{encoding}; png compressed", "data": data}
    return raw(topic, "sensor_msgs/msg/CompressedImage", fields, 5)


def camera_edge(parent: str, child: str) -> Fields:
    return transform_stamped(parent, child, stamp_ns=5, translation=(0.5, 0, 1), rotation_xyzw=OPTICAL)


STEREO = (image_message, "image_raw"), (info, "camera_info")


# --- lidars and the site frame


VELO_IN_CAMERA = transform_stamped("cam_optical", "velo", stamp_ns=5, rotation_xyzw=OPTICAL)


@pytest.mark.parametrize(
    ("edges", "frame", "site", "position"),
    [
        ([], "/velodyne", "velodyne", (0, 0, 0)),
        ([], "", "lidar", (0, 0, 0)),
        ([("map", "base_link", (9, 0, 0)), ("base_link", "a", (1, 0, 0))], "a", "base_link", (1, 0, 0)),
        ([("car", "base_link", (9, 0, 0)), ("site", "a", (1, 0, 0))], "a", "site", (1, 0, 0)),
        ([VELO_IN_CAMERA], "velo", "velo", (0, 0, 0)),
        ([("a", "b", (1, 0, 0)), ("b", "a", (1, 0, 0)), ("b", "c", (1, 0, 0))], "a", "a", (0, 0, 0)),  # b in a circle
        ([("utm", "gantry", (691000, 5336000, 0)), ("gantry", "a", (1, 0, 0))], "a", "gantry", (1, 0, 0)),
    ],
)
def test_the_site_of_one_lidar(edges: list[Any], frame: str, site: str, position: tuple[float, ...]) -> None:
    (lidar,) = discover([static(*edges), cloud("/points", frame)]).rig.lidars
    assert (lidar.name, lidar.topic, lidar.T_site_lidar.dst) == ("lidar", "/points", site)
    np.testing.assert_allclose(lidar.T_site_lidar.translation, position)


A, B, C = (cloud(f"/{name}_points", name) for name in "abc")


def moving(i: int, frame: str = "a") -> RawMessage:
    edge = transform_stamped("site", frame, stamp_ns=i, translation=(i, 0, 0))
    return raw("/tf", "tf2_msgs/msg/TFMessage", tf_message([edge]), i)


@pytest.mark.parametrize(("named", "notes"), [("a", ["/b_points, /c_points"]), ("abc", [])])
def test_sensors_that_a_rig_file_does_not_name_are_told(named: str, notes: list[str]) -> None:
    """Somebody who gives the time offset of one sensor loses the others."""
    file = {"lidars": {name: {"topic": f"/{name}_points"} for name in named}}
    found = discover([static(*(("site", name, (1, 0, 0)) for name in "abc")), A, B, C], file)
    assert [lidar.name for lidar in found.rig.lidars] == [*named]
    assert [*found.notes] == [f"not used, as the rig file names others alone: {topics}" for topics in notes]


CUT = A._replace(data=bytes(A.data)[:30])


@pytest.mark.parametrize(
    ("messages", "words"),
    [
        ([A], "no transform joins frame 'a' with 'site'"),
        ([A], "; give its pose in a rig file (--rig), or --set 'topics.exclude=[TOPIC]'"),
        ([*map(moving, range(3)), A], "a moves in site"),
        ([*(moving(i, "car") for i in range(3)), A], "frames with a fixed transform: b, c, site; car moves in site"),
        ([static(("a", "x", (0, 0, 0)), ("x", "a", (0, 0, 0))), A], "circle"),
        ([CUT], "none of its first 1 messages can be decoded"),
        ([CUT, A, static(("site", "a", (1, 0, 0)))], ""),
    ],
)
def test_a_lidar_that_cannot_be_used_is_a_fault(messages: list[RawMessage], words: str) -> None:
    found = discover([static(("site", "b", (1, 0, 0)), ("site", "c", (0, 1, 0))), B, C, *messages])
    assert [lidar.name for lidar in found.rig.lidars] == (["b", "c"] if words else ["a", "b", "c"])
    assert words in reasons(found).get("a", "")


@pytest.mark.parametrize(
    ("parent", "size_m", "is_used"), [("site", 0.05, True), ("site", 0.3, False), ("world", 0.05, False)]
)
def test_a_lidar_on_a_mast_that_sways_has_its_mean_pose(parent: str, size_m: float, is_used: bool) -> None:
    """What moves more, or in a frame that vehicles move in, may be going anywhere."""
    sent = []
    for i, (shift, y) in enumerate(((-1, 0.0), (0, 0.02), (1, -0.02))):
        place, turn = (1 + size_m * shift, 0, 0), (0, y, 0, float(np.sqrt(1 - y * y)))
        edge = transform_stamped(parent, "mast", stamp_ns=i, translation=place, rotation_xyzw=turn)
        sent.append(raw("/tf", "tf2_msgs/msg/TFMessage", tf_message([edge]), i))
    found = discover([static((parent, "b", (1, 0, 0)), ("mast", "a", (0, 1, 0))), *sent, A, B])
    assert [lidar.name for lidar in found.rig.lidars] == (["a", "b"] if is_used else ["a"])
    if is_used:
        pose = found.rig.lidars[0].T_site_lidar
        assert pose.dst == "site"
        np.testing.assert_allclose(pose.matrix[:3], [[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 1, 0]], atol=1e-6)
        assert "on tf, mast move by up to 2.3 degrees and 5 cm: the mean poses are used" in found.notes


def test_faults_that_differ_in_names_alone_are_told_once() -> None:
    told = "no transform joins frame 'a' with 'x'", "no transform joins frame 'a' with 'y'", "no K", "'' is no K"
    faults = [SensorFault(f"cam{i}", "/cam" * (i == 1), reason) for i, reason in enumerate([*told, told[1]])]
    assert faults_told(faults) == [
        ("cam0", told[0]),
        ("cam1 (/cam), cam4", "likewise"),
        ("cam2", told[2]),
        ("cam3", told[3]),
    ]


@pytest.mark.parametrize(
    ("later", "is_told"),
    [
        (("site", "a", (1, 0, 0)), False),
        (("site", "a", (5, 0, 0)), True),
        (("mast", "a", (1, 0, 0)), True),
        (("site", "b", (1, 0, 0)), False),
    ],
)
@pytest.mark.parametrize("topic", ["/tf_static", "/tf"])
def test_a_pose_that_changes_is_told(later: Any, is_told: bool, topic: str) -> None:
    fields = tf_message([transform_stamped(later[0], later[1], stamp_ns=5, translation=later[2])])
    other = raw(topic, "tf2_msgs/msg/TFMessage", fields, 5)
    found = discover([static(("site", "a", (1, 0, 0))), A, other])
    note = (
        "tf gives several poses of a: the last one of tf_static is used for the whole recording; if it is another one, "
        "give it in a rig file (transforms)"
    )
    assert found.notes == ((note,) if is_told else ())


@pytest.mark.parametrize(
    ("edge", "reason"),
    [
        (transform_stamped("base", "Lidar", stamp_ns=5), "tf has no such frame, but Lidar, base"),
        (
            transform_stamped("base", "lidar", stamp_ns=5, rotation_xyzw=(0, 0, 0, 0)),
            "its rotation [0.0, 0.0, 0.0, 0.0] is not a unit quaternion (/tf_static)",
        ),
        (transform_stamped("base", "lidar", stamp_ns=5), ""),
    ],
)
def test_a_lidar_whose_pose_tf_lacks_is_told(edge: Fields, reason: str) -> None:
    note = f"poses are in lidar, the lidar's own frame: {reason}; see transforms in a rig file (--rig)"
    assert discover([static(edge), cloud()]).notes == (note,) * bool(reason)
    assert discover([static(edge), cloud()], rig={"site_frame": "lidar"}).notes == ()


@pytest.mark.parametrize(("child", "is_told"), [("lidr", True), ("/lidar", False), ("mast", False)])
def test_transforms_of_the_rig_file_that_no_sensor_needs_are_told(child: str, is_told: bool) -> None:
    file = {"transforms": {"base": {child: {"rpy_deg": [0, 0, 90]}}}}
    found = discover([static(("mast", "lidar", (1, 0, 0))), cloud()], file)
    note = "no sensor needs the transforms of the rig file, to lidr: the sensors are in lidar"
    assert found.notes == (note,) * is_told


@pytest.mark.parametrize(("frame", "is_told"), [("right", True), ("/left", False), ("", False)])
def test_lidars_that_share_a_topic_are_told(frame: str, is_told: bool) -> None:
    found = discover([cloud("/points", "left"), cloud("/points", frame), cloud("/points", "left")])
    words = (
        "/points: its clouds are in the frames left, right, but all get the pose of one lidar: record each lidar on a "
        "topic of its own"
    )
    assert found.notes == ((words,) if is_told else ())


PANDAR = Channel("/hesai/packets", "pandar_msgs/msg/PandarScan", "cdr", "", "ros2msg")


@pytest.mark.parametrize(
    ("messages", "sections", "words"),
    [
        ([A], {"rig": {"site_frame": "map"}}, r"usable.*a \(/a_points\): no transform joins.*rig file"),
        ([A], {"topics": {"lidars": ["/none"]}}, r"in this recording: .*/none.*; correct topics\.lid"),
        ([A], {"topics": {"exclude": ["/a*"]}}, r"apart from /a.*see topics\.exclude"),
        ([cloud("/depth/points", "c")], {}, r"by its name, not used; to use them: .*topics\.lidars=\[/depth/points"),
        ([image_message("/camera/image_raw", "c")], {}, r"a topic of lidar clouds.*/camera/image_raw \(sensor_msgs"),
        ([], {}, "found topics: none"),
        ([image_message(f"/camera{i}/image_raw", "camera") for i in range(15)], {}, "and 5 more"),
        ([RawMessage(1, 1, (0, 0), b"", PANDAR)], {}, r"of a Hesai \(pandar_msgs/PandarScan\), which .* read; play"),
    ],
)
def test_no_usable_lidar_ends_the_run(messages: list[RawMessage], sections: dict[str, Any], words: str) -> None:
    with pytest.raises((CalibrationError, RecordingError), match=words):
        discover(messages, **sections)


@pytest.mark.parametrize("msgtype", [*UNDECODED])
def test_what_is_not_decoded_is_named(msgtype: str) -> None:
    source = Channel("/data", msgtype, "cdr", "", "ros2msg")
    found = discover([RawMessage(1, 1, (0, 0), b"", source), A, static(("site", "a", (1, 0, 0)))])
    [note] = [note for note in found.notes if note.startswith("/data: ")]
    assert f"({msgtype.replace('/msg/', '/')}), which lidcam does not read; " in note


@pytest.mark.parametrize(
    ("msgtype", "packet", "words"),
    [
        ("hesai_ros_driver/msg/UdpFrame", "eeff0104 04", "packets of a Hesai Pandar128 or OT128 ("),
        ("pandar_msgs/msg/PandarScan", "eeff0601", "packets of a Hesai PandarXT ("),
        ("hesai_lidar/msg/PandarScan", "eeff4006", "packets of a Hesai Pandar64 ("),
        ("rslidar_msg/msg/rslidarScan", "55aa050a5aa550a0" + 22 * "00" + "03", "packets of a RoboSense RS-Bpearl ("),
        ("rslidar_msg/msg/RslidarPacket", "55aa055a" + 27 * "00" + "06", "packets of a RoboSense RS-Helios ("),
        ("rslidar_msgs/msg/RslidarScan", "55aa055a" + 27 * "00" + "99", "packets of a RoboSense ("),
        ("ouster_ros/msg/PacketMsg", "", "packets of an Ouster ("),
        ("nebula_msgs/msg/NebulaPackets", "eeff0403", "packets of a Hesai AT128, by Nebula ("),
    ],
)
def test_the_packets_say_which_model_it_is(msgtype: str, packet: str, words: str) -> None:
    data = bytes(40) + bytes.fromhex(packet) + bytes(2000)
    found = discover([RawMessage(1, 1, (0, 0), data, Channel("/data", msgtype, "cdr", "", "ros2msg")), A])
    assert f"/data: {words}{msgtype.replace('/msg/', '/')}), which" in "".join(found.notes)


def packets(topic: str, frame: str = "", model: str = "VLP-16") -> RawMessage:
    return velodyne.scan(*velodyne.random_packets(model, packets=3), topic=topic, frame_id=frame)


@pytest.mark.parametrize(
    ("topic", "frame"), [("/velodyne_packets", "velodyne"), ("/front/velodyne_packets", "velodyne"), ("/packets", "a")]
)
def test_packets_are_left_out_where_their_clouds_were_recorded(topic: str, frame: str) -> None:
    points = "/points" if topic == "/packets" else "/velodyne_points"
    found = discover([packets(topic, frame), cloud(points, "velodyne"), static(("velodyne", "a", (0, 0, 0)))])
    assert [lidar.topic for lidar in found.rig.lidars] == [points]
    assert f"{topic}: packets of the same lidar as {points}, not used" in found.notes


@pytest.mark.parametrize(
    ("topic", "in_tf", "frame"),
    [
        ("/velodyne_packets", "velodyne", "velodyne"),
        ("/velodyne_packets", "top", "velodyne"),
        ("/front/velodyne_packets", "front", "front"),
        ("/front/velodyne_packets", "front_velodyne", "front_velodyne"),
        ("/velodyne_10_0_0_7/packets", "velodyne_10_0_0_7", "velodyne_10_0_0_7"),
    ],
)
def test_packets_without_a_frame_have_the_one_that_tf_knows(topic: str, in_tf: str, frame: str) -> None:
    found = discover([packets(topic), static(("site", in_tf, (1, 0, 0)))])
    [lidar] = found.rig.lidars
    assert lidar.T_site_lidar.src == frame
    assert (found.rig.site_frame == "site") == (frame == in_tf)


def test_several_lidars_without_any_pose_need_a_rig_file() -> None:
    messages = [packets("/velodyne_10_0_0_1/packets"), packets("/velodyne_10_0_0_2/packets")]
    with pytest.raises(CalibrationError, match=r"found 2 lidars \(.*_1/packets, .*_2/packets\).*a rig file \(--rig\)"):
        discover(messages)
    one = {"lidars": ["/velodyne_10_0_0_2/packets"]}
    assert [lidar.topic for lidar in discover(messages, topics=one).rig.lidars] == one["lidars"]
    lidars = {f"velodyne_10_0_0_{n}": {"translation_m": (n, 0, 0)} for n in (1, 2)}
    found = discover(messages, {"site_frame": "site", "lidars": lidars})
    assert [lidar.T_site_lidar.translation.tolist() for lidar in found.rig.lidars] == [[1, 0, 0], [2, 0, 0]]


def test_packets_of_an_unknown_model_are_a_fault_with_a_remedy() -> None:
    messages = [packets("/velodyne_packets", "velodyne", "VLP-32A")]
    with pytest.raises(CalibrationError, match=r"found VLP-32A or VLP-32B; set velodyne\.model"):
        discover(messages)
    assert len(discover(messages, velodyne={"model": "VLP-32A"}).rig.lidars) == 1


def test_topics_are_left_out_by_pattern_or_chosen() -> None:
    truth = cloud("/ground_truth/points", "a")
    messages = [static(("s", "a", (0, 0, 0)), ("s", "b", (0, 0, 0))), A, B, truth]
    assert [lidar.name for lidar in discover(messages, topics={"exclude": ["/b*"]}).rig.lidars] == ["a"]
    chosen = discover(messages, topics={"lidars": ["/b_points", "/c_points"]})
    assert [lidar.name for lidar in chosen.rig.lidars] == ["b"]
    assert reasons(chosen)["lidar"].endswith("it has /a_points, /b_points")


# --- cameras


def rig_with(*messages: RawMessage, edges: Iterable[str] = ("cam",), **sections: Any) -> Discovery:
    return discover(
        [static(*(camera_edge("velo", e) for e in edges)), cloud("/velo_points", "velo"), *messages], **sections
    )


def test_a_camera_needs_camera_info_and_a_transform() -> None:
    found = rig_with(image_message("/camera/image_raw", "cam"), info("/camera/camera_info", "cam"))
    camera = found.rig.cameras[0]
    assert (camera.name, camera.topic, camera.boxes_topic) == ("camera", "/camera/image_raw", "")
    assert (camera.T_camera_site.dst, camera.T_camera_site.src) == ("cam", "velo")
    np.testing.assert_allclose(camera.T_camera_site.apply(np.array([10.5, 0, 1.0])), [0, 0, 10], atol=1e-12)
    assert found.faults == ()
    assert found.sources[1].intrinsics == "/camera/camera_info (no distortion)"


def test_cameras_in_one_place_are_told() -> None:
    """As drivers of stereo cameras stamp both images with the frame of the left one."""
    messages = [message(f"/{name}/{topic}", "base_link") for name in "ab" for message, topic in STEREO]
    found = discover([static(("base_link", "velo", (0, 0, 1))), cloud("/velo_points", "velo"), *messages])
    assert found.rig.site_frame == "base_link", "as a camera of it is taken to look forward"
    assert found.notes[-1] == (
        "a, b: all in frame base_link and so in one place: if they are several cameras, give each its pose in a rig "
        "file (--rig)"
    )


def test_frames_without_the_prefix_of_tf_are_told() -> None:
    """As frame_prefix of robot_state_publisher makes them."""
    edges = (camera_edge("robot/base_link", "robot/cam"), ("robot/base_link", "robot/velo", (0, 0, 1)))
    messages = [cloud("/velo_points", "velo"), *(message(f"/c/{topic}", "cam") for message, topic in STEREO)]
    reason = reasons(discover([static(*edges), *messages]))["c"]
    assert "name the frames as tf does (robot/cam, robot/velo) with frame_id in a rig file (--rig), or give" in reason
    entries = {"lidars": {"velo": {"frame_id": "robot/velo"}}, "cameras": {"c": {"frame_id": "robot/cam"}}}
    named = discover([static(*edges), *messages], entries)
    assert (named.rig.site_frame, len(named.rig.cameras)) == ("robot/base_link", 1)


def test_cameras_with_one_name_for_their_frames_have_frames_of_their_own() -> None:
    """As drivers come; the poses are those of a rig file."""
    names = ("a", "b")
    cameras = {}
    for x, name in enumerate(names):
        T_camera_site = np.eye(4)
        T_camera_site[0, 3] = x
        cameras[name] = {"topic": f"/{name}/image_raw", "frame_id": "camera", "T_camera_site": T_camera_site.tolist()}
    messages = [image_message(f"/{name}/image_raw", "camera") for name in names]
    messages += [info(f"/{name}/camera_info", "camera") for name in names]
    found = discover([cloud("/velo_points", "velo"), *messages], {"site_frame": "velo", "cameras": cameras})
    assert [camera.T_camera_site.dst for camera in found.rig.cameras] == ["camera", "camera_b"]
    assert "b: another sensor has its frame camera, too; in the result it is camera_b" in found.notes


@pytest.mark.parametrize(
    ("calibration", "edges", "reason"),
    [
        ([], ["cam"], "no CameraInfo"),
        ([info("/c/camera_info", "cam")], [], "no transform joins frame 'velo' with 'cam'"),
        ([info("/c/camera_info", "cam", K=np.zeros((3, 3)))], ["cam"], "uncalibrated"),
        ([info("/c/camera_info", "cam", K=K * [[1e6], [1], [1]])], ["cam"], "focal"),
        (
            [info("/c/camera_info", "cam", width_px=32, height_px=24)],
            ["cam"],
            "64 x 48 px, but",
        ),  # K is not for 32 x 24
        ([info("/c/camera_info", "cam", width_px=64, height_px=64)], ["cam"], "64 x 48 px, but"),
    ],
)
def test_camera_faults_leave_a_rig_of_lidars(calibration: list[RawMessage], edges: list[str], reason: str) -> None:
    found = rig_with(image_message("/c/image_raw", "cam"), *calibration, edges=edges)
    assert found.rig.cameras == ()
    assert reason in reasons(found)["c"]


def test_the_first_camera_info_with_a_calibration_counts() -> None:
    """Drivers send empty ones until theirs is loaded."""
    empty = info("/c/camera_info", "cam", K=np.zeros((3, 3)))
    found = rig_with(image_message("/c/image_raw", "cam"), empty, empty, info("/c/camera_info", "cam"))
    np.testing.assert_array_equal(found.rig.cameras[0].model.K, K)


def test_a_camera_info_without_a_size_has_that_of_the_images() -> None:
    unsized = info("/c/camera_info", "cam", width_px=0, height_px=0)
    found = rig_with(image_message("/c/image_raw", "cam"), unsized)
    (camera,) = found.rig.cameras
    assert (camera.model.width_px, camera.model.height_px) == (64, 48)
    np.testing.assert_array_equal(camera.model.K, K)
    assert found.notes == ("c: /c/camera_info has no image size: its images' is taken",)


def test_p_is_used_where_k_is_of_another_image() -> None:
    of_sensor = info("/c/camera_info", "cam", K=np.add(K, [[0, 0, 6], [0, 0, 4], [0, 0, 0]]), P=np.c_[K, [1, 2, 3]])
    found = rig_with(image_message("/c/image_raw", "cam"), of_sensor)
    np.testing.assert_array_equal(found.rig.cameras[0].model.K, K)
    assert found.sources[1].intrinsics == "P of /c/camera_info (no distortion)"
    assert found.notes[-1].startswith(
        "c: P of /c/camera_info is used, without distortion: its K is of an image of anoth"
    )


@pytest.mark.parametrize(("factor", "is_told"), [(1, False), (2, True)])
def test_a_k_of_another_size_is_told(factor: float, is_told: bool) -> None:
    """As of a node that shrinks images and their CameraInfo, but not the matrices in it."""
    shrunk = info("/c/camera_info", "cam", K=K * [[factor], [factor], [1]])
    found = rig_with(image_message("/c/image_raw", "cam"), shrunk)
    note = (
        "c: its principal point (64, 48) is far from the middle of its images of 64 x 48 px: unless they are cropped, "
        "its K is for images of another size"
    )
    assert found.notes == (note,) * is_told


@pytest.mark.parametrize("scale", [0.5, 2 / 3, 4])
def test_calibrations_of_scaled_images_are_scaled(scale: float) -> None:
    """Pixel x of an image is (x + 0.5) s - 0.5 of the scaled one."""
    width, height = round(630 * scale), round(420 * scale)
    calibration = info(
        "/c/camera_info", "cam", K=[[500, 0, 312], [0, 500, 204], [0, 0, 1]], width_px=630, height_px=420
    )
    found = rig_with(image_message("/c/image_raw", "cam", size=(width, height)), calibration)
    [camera] = found.rig.cameras
    assert (camera.model.width_px, camera.model.height_px) == (width, height)
    expected = np.array([[500 * scale, 0, 312.5 * scale - 0.5], [0, 500 * scale, 204.5 * scale - 0.5], [0, 0, 1]])
    np.testing.assert_allclose(camera.model.K, expected)
    assert found.sources[1].intrinsics.endswith(", scaled")
    assert f"is for 630 x 420 px, its images are {width} x {height}: the calibration is scaled" in found.notes[-1]


SIDES = {"left": 1, "right": 0}


@pytest.mark.parametrize(
    ("messages", "edges", "expected"),
    [
        (
            [
                *(image_message(f"/image_raw_{n}", f"cam{n}") for n in (12, 11)),
                *(info(f"/camera_info_{n}", f"cam{n}") for n in (11, 12)),
                *(boxes_2d(f"/detections_{n}", "") for n in (12, 11)),
            ],
            ("cam11", "cam12"),
            [("cam11", "/detections_11", "cam11"), ("cam12", "/detections_12", "cam12")],
        ),
        (
            [
                *(image_message(f"/{side}/image", f"cam_{side}") for side in SIDES),
                *(info(f"/calibration/{n}", f"cam_{side}") for side, n in SIDES.items()),
                *(boxes_2d(f"/yolo/{n}", f"cam_{side}") for side, n in SIDES.items()),
            ],
            ("cam_left", "cam_right"),
            [("left", "/yolo/1", "cam_left"), ("right", "/yolo/0", "cam_right")],
        ),
    ],
)
def test_topics_pair_up_by_place_else_by_frame(
    messages: list[RawMessage], edges: tuple[str, str], expected: list[tuple[str, str, str]]
) -> None:
    cameras = rig_with(*messages, edges=edges).rig.cameras
    assert [(c.name, c.boxes_topic, c.model.frame_id) for c in cameras] == expected


@pytest.mark.parametrize("detections", [["/camera/detections"], []])
def test_true_boxes_are_not_those_of_a_detector(detections: list[str]) -> None:
    truths = [f"/ground_truth/camera/{kind}" for kind in ("visible", "whole")]
    found = rig_with(
        image_message("/camera/image_raw", "cam"),
        info("/camera/camera_info", "cam"),
        *(boxes_2d(topic, "cam") for topic in (*detections, *truths)),
    )
    assert found.rig is not None
    assert [camera.boxes_topic for camera in found.rig.cameras] == [*(detections or [""])]


def test_one_camera_is_taken_once_and_raw() -> None:
    found = rig_with(
        compressed("/camera/image_raw/compressed", "cam"),
        image_message("/camera/image_raw", "cam"),
        image_message("/camera/image_rect", "cam"),
        image_message("/camera/depth/image_raw", "cam"),
        image_message("/camera/range/image_raw", "cam", encoding="16UC1"),
        compressed("/camera/tof/image_raw/compressed", "cam", "16UC1"),
        info("/camera/camera_info", "cam"),
    )
    assert [camera.topic for camera in found.rig.cameras] == ["/camera/image_raw"]
    assert len(found.notes) == 5


@pytest.mark.parametrize(
    ("messages", "name"),
    [
        ([compressed("/cam11/image/compressed", "cam"), info("/cam11/camera_info", "cam")], "cam11"),
        (
            [
                *(image_message("/zed/left/image_rect_color", "cam"), info("/zed/left/camera_info", "cam")),
                *(image_message("/zed/left_raw/image_raw_color", "cam"), info("/zed/left_raw/camera_info", "cam")),
            ],
            "zed_left",
        ),
        ([image_message("/webcam", ""), info("/calibration", "cam")], "webcam"),  # one of each: they belong together
    ],
)
def test_one_camera(messages: list[RawMessage], name: str) -> None:
    assert [(camera.name, camera.model.width_px) for camera in rig_with(*messages).rig.cameras] == [(name, 64)]


def test_boxes_alone_make_a_camera() -> None:
    boxes = boxes_2d("/cam11/detections", "cam"), boxes_2d("/other/detections", "")
    found = rig_with(*boxes, info("/cam11/camera_info", "cam"))
    assert [(c.name, c.topic, c.boxes_topic) for c in found.rig.cameras] == [("cam11", "", "/cam11/detections")]
    fault = "the recording has no CameraInfo of it: give its K in a rig file (--rig; inspect --write-rig drafts one)"
    assert [(one.topic, one.reason) for one in found.faults] == [("/other/detections", fault)]
    size = {"width_px": 64, "height_px": 48}
    camera = {"boxes_topic": "/other/detections", **size, "K": np.reshape(K, (3, 3)).tolist()}
    known = {"site_frame": "a", "cameras": {"other": {**camera, "translation_m": [0, 0, 1], "rpy_deg": [0, 0, 0]}}}
    found = discover([A, *boxes], known)
    assert [(c.name, c.boxes_topic) for c in found.rig.cameras] == [("other", "/other/detections")]
    assert not found.faults
    assert not any("/other/detections" in note for note in found.notes)


@pytest.mark.parametrize(
    ("of_info", "of_image", "frame"), [("cam", "other", "cam"), ("other", "cam", "cam"), ("", "cam", "cam")]
)
def test_the_frame_of_a_camera_is_one_that_tf_has(of_info: str, of_image: str, frame: str) -> None:
    found = rig_with(image_message("/c/image", of_image), info("/c/camera_info", of_info))
    assert [camera.model.frame_id for camera in found.rig.cameras] == [frame]


def test_rectified_images_are_projected_in_the_rectified_frame() -> None:
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    calibration = info("/c/camera_info", "cam", R=turn, distortion=(0.1, 0, 0, 0, 0))
    found = rig_with(image_message("/c/image_rect", "cam"), calibration)
    camera = found.rig.cameras[0]
    assert camera.T_camera_site.dst == camera.model.frame_id == "cam_rectified"
    assert not camera.model.distortion.any()
    ahead_and_left = np.array([10.5, 1.0, 1.0])  # (-1, 0, 10) in the camera
    np.testing.assert_allclose(camera.T_camera_site.apply(ahead_and_left), [0, -1, 10], atol=1e-12)


@pytest.mark.parametrize(
    ("options", "is_open"),
    [
        ({"distortion": (0.1, 0, 0, 0, 0)}, True),
        ({"P": np.c_[np.diag([20.0, 20, 1]) @ K, np.zeros(3)]}, True),
        ({}, False),
        ({"distortion": (0.1, 0, 0, 0, 0), "P": np.zeros((3, 4))}, False),
    ],
    ids=["distorted", "other focal length", "the same", "without P"],
)
def test_images_that_may_be_rectified_have_two_lenses(options: dict[str, Any], is_open: bool) -> None:
    calibration = info("/c/camera_info", "cam", **options)
    [camera] = rig_with(image_message("/c/image", "cam"), calibration).rig.cameras
    assert (camera.rectified is not None) == is_open
    if camera.rectified is not None:
        assert not camera.rectified.model.distortion.any()
        assert camera.rectified.T_camera_site.dst == "cam"
    rect = rig_with(image_message("/c/image_rect", "cam"), calibration).rig.cameras if is_open else ()
    assert all(one.rectified is None for one in rect)


LEVEL, PITCHED = (0.0, 0.0, 0.0, 1.0), (0.0, 0.2588190451, 0.0, 0.9659258263)  # 30 degrees down
STEEP = (0.0, 0.4617486132, 0.0, 0.8870108332)  # 55 degrees down, as from a mast
DOWN = (0.0, 0.7071067812, 0.0, 0.7071067812)


@pytest.mark.parametrize(
    ("frame", "rotation", "forward"),
    [
        ("cam_link", LEVEL, (1, 0, 0)),
        ("cam_link", PITCHED, (np.cos(np.pi / 6), 0, -0.5)),
        ("cam_link", STEEP, (np.cos(np.radians(55)), 0, -np.sin(np.radians(55)))),
        ("cam_link", OPTICAL, (1, 0, 0)),
        ("cam_optical", LEVEL, (0, 0, 1)),  # as its name says
        ("cam_link", DOWN, (1, 0, 0)),  # its z axis is level: an optical frame
    ],
)
def test_cameras_in_the_frame_of_their_body(
    frame: str, rotation: tuple[float, ...], forward: tuple[float, ...]
) -> None:
    edge = transform_stamped("lidar", frame, stamp_ns=5, rotation_xyzw=rotation)
    images = [image_message("/cam/image_raw", frame), info("/cam/camera_info", frame)]
    found = discover([static(edge), cloud("/points", "lidar"), *images])
    (camera,) = found.rig.cameras
    np.testing.assert_allclose(camera.T_camera_site.matrix[2, :3], forward, atol=1e-6)
    is_body = frame == "cam_link" and rotation in (LEVEL, PITCHED, STEEP)
    assert [note for note in found.notes if "looks at the sky" in note] == [
        f"cam: as an optical frame, {frame} looks at the sky: taken as the frame of its body, x forward"
    ] * is_body
    assert found.sources[1].extrinsics == f"tf: lidar <- {frame}{' (x forward)' * is_body}"
