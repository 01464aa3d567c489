"""Recordings of whole robots: what nodes made of clouds and images is no lidar and no camera."""

from collections.abc import Callable, Iterable, Mapping
from functools import cache
from types import MappingProxyType
from typing import Any, NamedTuple

import cv2
import numpy as np
import pytest
from builders import camera_info, image, pointcloud2, raw, tf_message, transform_stamped
from rig_messages import discover, static
from velodyne import random_packets, scan

from lidcam.pipeline.core.arrays import Array
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.recording import VelodyneConfig
from lidcam.readers.velodyne.decoder import VelodyneDecoder

START_NS, STEP_NS, SWEEPS = 1_700_000_000 * 10**9, 100_000_000, 12
RAW = "/velodyne_points"
OPTICAL = (-0.5, 0.5, -0.5, 0.5)
Made = Callable[["Sweep"], Iterable[RawMessage]]


class Sweep(NamedTuple):
    number: int
    stamp_ns: int
    xyz: Array
    fields: dict[str, Array]  # Intensity, ring, time and reflectivity of each point

    @property
    def intensity(self) -> dict[str, Array]:
        return {"intensity": self.fields["intensity"]}

    @property
    def driven(self) -> Array:
        return np.array([0.8 * self.number, 0, 0], np.float32)

    @property
    def deskewed(self) -> Array:
        return np.asarray(self.xyz + self.fields["time"][:, None] * np.array([8, 0.2, 0], np.float32))


@cache
def sweep(number: int, seed: int = 0, points: int = 12000) -> Sweep:
    """A street: ground and two walls, sampled anew in every sweep, in the order of a turning head."""
    chance = np.random.default_rng((seed, number))
    azimuth, elevation = np.sort(chance.uniform(-np.pi, np.pi, points))[::-1], chance.uniform(-0.7, 0.15, points)
    ray = np.c_[np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)]
    range_m = np.minimum(1.7 / np.maximum(-ray[:, 2], 0.06), 6 / np.maximum(np.abs(ray[:, 1]), 0.2))
    xyz = (range_m[:, None] * ray).astype(np.float32)
    fields: dict[str, Array] = {
        "intensity": chance.uniform(0, 255, points).astype(np.float32),
        "ring": (40 * (elevation + 0.7)).astype(np.uint16),
        "time": np.linspace(0, 0.1, points).astype(np.float32),
        "reflectivity": chance.integers(0, 256, points).astype(np.uint16),  # of an Ouster; nodes hand on the intensity
    }
    return Sweep(number, START_NS + number * STEP_NS, xyz, fields)


def cloud(
    topic: str,
    one: Sweep,
    xyz: Array,
    frame: str,
    fields: Mapping[str, Array] = MappingProxyType({}),
    *,
    late_ms: float = 30,
    shift_ns: int = 0,
) -> RawMessage:
    """A cloud that was recorded so long after the end of the sweep."""
    stamp_ns, log_ns = one.stamp_ns + shift_ns, one.stamp_ns + STEP_NS + round(late_ms * 1e6)
    points = np.asarray(xyz, np.float32)
    content = pointcloud2(points, stamp_ns=stamp_ns, frame_id=frame, **fields)  # type: ignore[arg-type]  # columns
    return raw(topic, "sensor_msgs/msg/PointCloud2", content, stamp_ns, log_ns)


def moved(one: Sweep, parent: str, child: str) -> RawMessage:
    edge = transform_stamped(parent, child, stamp_ns=one.stamp_ns, translation=one.driven.tolist())
    return raw("/tf", "tf2_msgs/msg/TFMessage", tf_message([edge]), one.stamp_ns)


def thinned(xyz: Array, cell_m: float) -> Array:
    """The means of the points of each cell."""
    _, cells = np.unique(np.floor(xyz / cell_m), axis=0, return_inverse=True)
    counts = np.bincount(cells.ravel())
    return np.stack([np.bincount(cells.ravel(), axis) / counts for axis in xyz.T], 1)


def computed(xyz: Array) -> dict[str, Array]:
    return {name: np.zeros(len(xyz), np.float32) for name in ("normal_x", "normal_y", "normal_z", "curvature")}


def fast_lio(one: Sweep) -> Iterable[RawMessage]:
    world, body = one.deskewed + one.driven, one.deskewed + np.array([0.04, 0.02, -0.03], np.float32)
    fields = one.intensity | computed(world)
    yield cloud("/cloud_registered", one, world, "camera_init", fields, shift_ns=STEP_NS)
    yield cloud("/cloud_registered_body", one, body, "body", fields, shift_ns=STEP_NS)
    yield cloud("/Laser_map", one, np.concatenate([world] * 3), "camera_init", shift_ns=STEP_NS)
    yield moved(one, "camera_init", "body")


def lio_sam(one: Sweep) -> Iterable[RawMessage]:
    rounded = int(np.float64(one.stamp_ns / 1e9) * 1e9) - one.stamp_ns
    by_ring = np.lexsort((-one.fields["time"], one.fields["ring"]))  # imageProjection.cpp: columns run against the head
    kept = by_ring[np.hypot(*one.deskewed[by_ring, :2].T) > 3]
    own = {"intensity": one.fields["intensity"][kept]}
    yield cloud("/lio_sam/deskew/cloud_deskewed", one, one.deskewed[kept], "lidar_link", own, shift_ns=rounded)
    yield cloud("/lio_sam/feature/cloud_surface", one, thinned(one.deskewed, 0.4), "lidar_link", shift_ns=rounded)
    yield cloud("/lio_sam/mapping/cloud_registered", one, one.deskewed + one.driven, "odom", shift_ns=rounded)
    yield from (moved(one, "odom", "base_link"), moved(one, "map", "odom"))


def lego_loam(one: Sweep) -> Iterable[RawMessage]:
    """Of which /camera has LOAM's axes: x to the left, y up, z ahead."""
    by_ring = np.lexsort((one.fields["time"], one.fields["ring"]))[: len(one.xyz) * 3 // 4]
    ranges = {"intensity": np.linalg.norm(one.xyz[by_ring], axis=1).astype(np.float32)}
    yield cloud("/full_cloud_info", one, one.xyz[by_ring], "base_link", ranges)
    yield cloud("/segmented_cloud_pure", one, one.xyz[by_ring[::5]], "base_link")
    yield cloud("/laser_cloud_sharp", one, one.deskewed[by_ring[::40]][:, [1, 2, 0]], "/camera")
    yield cloud("/laser_cloud_less_flat", one, thinned(one.deskewed, 0.2)[:, [1, 2, 0]], "/camera")
    yield cloud("/registered_cloud", one, (one.deskewed + one.driven)[:, [1, 2, 0]], "/camera_init")
    yield moved(one, "camera_init", "camera")


def autoware(one: Sweep) -> Iterable[RawMessage]:
    one.fields["intensity"] //= 16  # few values, as most lidars send: their order alone tells that they were copied
    kept = (np.abs(one.xyz[:, :2]) > (2.2, 1)).any(1) & (one.fields["time"] > 0.02)
    rest = np.arange(len(one.xyz)) % 11 > 0
    to_base = np.array([1.2, 0, 1.9], np.float32)
    all_fields = {name: column[kept] for name, column in one.fields.items()}
    yield cloud("/sensing/lidar/top/self_cropped/pointcloud_ex", one, one.xyz[kept] + to_base, "base_link", all_fields)
    rectified = one.deskewed[kept] + to_base
    yield cloud("/sensing/lidar/top/rectified/pointcloud_ex", one, rectified, "base_link", all_fields)
    own = {"intensity": one.fields["intensity"][kept & rest]}
    left = one.deskewed[kept & rest] + to_base
    yield cloud("/sensing/lidar/top/outlier_filtered/pointcloud", one, left, "base_link", own)
    yield cloud("/sensing/lidar/concatenated/pointcloud", one, left, "base_link", own, late_ms=60)
    yield cloud("/perception/obstacles", one, left[left[:, 2] > 0.5], "base_link", late_ms=80)
    yield cloud("/util/downsample/pointcloud", one, thinned(left, 1.5), "base_link", late_ms=90)


def corrected(frame: str, up_m: float = 0) -> Made:
    """A cloud without times, rings and intensities in a frame that tf does not have."""

    def of_sweep(one: Sweep) -> Iterable[RawMessage]:
        yield cloud("/deskewed", one, one.deskewed + np.array([0, 0, up_m], np.float32), frame)

    return of_sweep


def in_another_order(one: Sweep) -> Iterable[RawMessage]:
    kept = np.random.default_rng(5).permutation(len(one.xyz))[: len(one.xyz) * 3 // 4]
    own = {"intensity": one.fields["intensity"][kept]}
    yield cloud("/deskewed", one, (one.deskewed + np.array([0, 0, 1.9], np.float32))[kept], "base_link", own)


def in_its_frame(one: Sweep) -> Iterable[RawMessage]:
    low = one.xyz[:, 2] < -1.5
    yield cloud("/a_filtered", one, one.xyz[::2], "velodyne")
    yield cloud("/ground", one, one.xyz[low], "velodyne")
    yield cloud("/obstacles", one, one.xyz[~low], "velodyne")
    yield cloud("/clusters", one, one.xyz[: 20 * (one.number % 3)], "velodyne")


def in_a_grid(one: Sweep) -> Iterable[RawMessage]:
    yield cloud("/downsampled", one, thinned(one.xyz, 0.1), "velodyne")


def in_many_steps(one: Sweep) -> Iterable[RawMessage]:
    """Of each of several lidars, Autoware has eight clouds."""
    return (cloud(f"/step_{number}/points", one, one.xyz[number::20], "velodyne") for number in range(44))


def stamped(frame: str, shift_ns: int | None) -> Made:
    """Obstacles whose node writes a stamp of its own, or none."""

    def of_sweep(one: Sweep) -> Iterable[RawMessage]:
        shift = -one.stamp_ns if shift_ns is None else shift_ns
        yield cloud("/obstacles", one, one.xyz[one.xyz[:, 2] > -1.5], frame, shift_ns=shift)

    return of_sweep


def in_slam_origin(one: Sweep) -> Iterable[RawMessage]:
    yield cloud("/local_map", one, one.xyz + one.driven, "slam_origin")
    yield moved(one, "slam_origin", "tracker")


def of_a_stereo_camera(one: Sweep) -> Iterable[RawMessage]:
    yield cloud("/oak/points", one, one.xyz[::7] + 0.1, "oak_right_camera_optical_frame")


def of_a_radar(one: Sweep) -> Iterable[RawMessage]:
    yield cloud("/radar_front", one, one.xyz[:90], "radar", {"rcs": np.zeros(90), "vx_comp": np.zeros(90)}, shift_ns=7)


def of_a_plain_radar(one: Sweep) -> Iterable[RawMessage]:
    echoes = np.random.default_rng(one.number).uniform(-30, 30, (60 * (one.number % 3), 3))
    yield cloud("/radar_front", one, echoes, "radar", {"intensity": np.zeros(len(echoes), np.float32)}, shift_ns=7)


def maps(one: Sweep) -> Iterable[RawMessage]:
    if one.number == 3:
        yield cloud("/map", one, one.xyz, "map")
        yield cloud("/prior_cloud", one, one.xyz, "prior")


def beside(frame: str, x_m: float = 0, points: int = 12000, *, is_full: bool = True) -> Made:
    """A second lidar, one with a camera inside: it sees the same street, but not the same points."""

    def of_sweep(one: Sweep) -> Iterable[RawMessage]:
        other = sweep(one.number, 1, points)
        fields = other.fields | {"rgb": other.fields["intensity"]} if is_full else other.intensity
        yield cloud("/left/points", one, other.xyz + np.array([x_m, 0, 0]), frame, fields)

    return of_sweep


def of_the_same_kind(one: Sweep) -> Iterable[RawMessage]:
    """Simulated with little noise, above level ground and beside the first, and often hidden."""
    chance, seen = np.random.default_rng(one.number), slice(0 if one.number % 2 else None)
    other = one.xyz + chance.normal(0, 0.003, one.xyz.shape)
    own = {"intensity": chance.uniform(0, 255, len(other)).astype(np.float32)[seen]}
    yield cloud("/left/points", one, other[seen], "velodyne", own)


def merged(one: Sweep) -> Iterable[RawMessage]:
    """Two simulated lidars without times and rings, and both in one cloud."""
    other = sweep(one.number, 1)
    yield cloud("/left/points", one, other.xyz - np.array([0, 0.5, 0], np.float32), "left", other.intensity)
    both = np.concatenate([one.xyz, other.xyz]) + np.array([1.2, 0, 1.9], np.float32)
    yield cloud("/merged", one, both, "base_link", late_ms=40)


def merged_by_the_first(one: Sweep) -> Iterable[RawMessage]:
    """The same in the frame of the first lidar."""
    other = sweep(one.number, 1)
    yield next(iter(merged(one)))
    own = {"intensity": np.concatenate([one.fields["intensity"], other.fields["intensity"]])}
    yield cloud("/merged", one, np.concatenate([one.xyz, other.xyz]), "velodyne", own, late_ms=40)


VELODYNE, LEFT, LINK = (
    ("base_link", "velodyne", (1.2, 0, 1.9)),
    ("base_link", "left", (1.2, 0.5, 1.9)),
    ("base_link", "lidar_link", (0, 0, 0)),
)


@pytest.mark.parametrize(
    ("made", "is_full", "edges", "others"),
    [
        (fast_lio, True, [], []),
        (lio_sam, True, [LINK], []),
        (lio_sam, True, [LINK, ("lidar_link", "velodyne", (0, 0, 0))], []),
        (lio_sam, True, [], []),
        (lio_sam, False, [], []),
        (corrected("lidar_link"), False, [], []),
        (corrected("base_link", 1.9), True, [], []),
        (in_another_order, False, [], []),
        (lego_loam, True, [], []),
        (lego_loam, False, [], []),
        (autoware, True, [VELODYNE], []),
        (in_its_frame, False, [], []),
        (in_a_grid, False, [], []),
        (in_many_steps, False, [], []),
        (stamped("velodyne", 130_000_000), False, [], []),
        (stamped("base_link", None), False, [("base_link", "velodyne", (0, 0, 0))], []),
        (stamped("", None), True, [], []),
        (in_slam_origin, True, [VELODYNE], []),
        (of_a_stereo_camera, True, [VELODYNE], []),
        (of_a_radar, False, [VELODYNE, ("base_link", "radar", (3, 0, 0.5))], []),
        (of_a_plain_radar, False, [VELODYNE, ("base_link", "radar", (3, 0, 0.5))], []),
        (maps, True, [VELODYNE], []),
        (beside("left"), True, [VELODYNE, LEFT], ["/left/points"]),
        (beside("velodyne"), True, [VELODYNE], ["/left/points"]),  # whose driver writes the same frame
        (beside("velodyne", points=3000), True, [VELODYNE], ["/left/points"]),
        (beside("velodyne", is_full=False), True, [VELODYNE], ["/left/points"]),
        (of_the_same_kind, True, [VELODYNE], ["/left/points"]),
        (beside("map", 20), True, [VELODYNE, ("map", "base_link", (0, 0, 0))], ["/left/points"]),  # at the roadside
        (merged, False, [VELODYNE, LEFT], ["/left/points"]),
        (merged_by_the_first, False, [VELODYNE, LEFT], ["/left/points"]),
        (merged_by_the_first, False, [("velodyne", "left", (0, 0.5, 0))], ["/left/points"]),
    ],
)
def test_the_lidars(made: Made, edges: Any, others: list[str], *, is_full: bool) -> None:
    found = discover([*recorded(made, is_full=is_full), static(*edges)])
    assert [lidar.topic for lidar in found.rig.lidars] == [*others, RAW]
    assert [camera.name for camera in found.rig.cameras] == ["camera"]
    assert found.faults == ()
    if not others or made in (merged, merged_by_the_first):
        assert found.notes[-1] == f"lidars: {', '.join([*others, RAW])}; to choose others: " + (
            f"--set 'topics.lidars=[{','.join([*others, RAW])}]'"
        )


def recorded(made: Made, *, is_full: bool = True) -> list[RawMessage]:
    """A lidar, with times and rings of points or without, a camera that is fixed to it, and what was made of both."""
    messages = [camera_edge("velodyne", "cam")]
    for one in map(sweep, range(SWEEPS)):
        messages += [
            *made(one),
            cloud(RAW, one, one.xyz, "velodyne", one.fields if is_full else one.intensity, late_ms=0),
            picture("/camera/image_raw", one, "cam"),
            calibration("/camera/camera_info", one, "cam"),
        ]
    return messages


def camera_edge(parent: str, child: str) -> RawMessage:
    return static(transform_stamped(parent, child, stamp_ns=5, translation=(0.5, 0, -0.2), rotation_xyzw=OPTICAL))


def test_a_lidar_whose_frame_carries_another_is_used() -> None:
    found = discover(recorded(lambda one: [*beside("trailer")(one), moved(one, "velodyne", "trailer")]))
    assert [lidar.topic for lidar in found.rig.lidars] == [RAW]
    assert [fault.topic for fault in found.faults] == ["/left/points"]


@pytest.mark.parametrize("edges", [[], [camera_edge("velodyne", "cam")]])
def test_a_second_lidar_in_a_frame_that_tf_lacks_is_a_fault(edges: list[RawMessage]) -> None:
    found = discover([*recorded(beside("left"))[1:], *edges])
    assert [fault.topic for fault in found.faults if fault.sensor != "camera"] == [RAW if not edges else "/left/points"]


def test_what_the_rig_file_names_is_a_sensor() -> None:
    file = {"lidars": {"one": {"topic": RAW}, "other": {"topic": "/deskewed"}}}
    found = discover(recorded(corrected("velodyne")), file)
    assert [lidar.topic for lidar in found.rig.lidars] == [RAW, "/deskewed"]
    assert not any("made of" in note for note in found.notes)
    assert any("or of a lidar that no tr" in note for note in discover(recorded(corrected("lidar_link"))).notes)


def test_a_cloud_made_of_packets_is_no_lidar() -> None:
    payload, stamps_ns = random_packets("VLP-16", packets=76)
    messages = list[RawMessage]()
    for number in range(SWEEPS):
        packets = scan(payload, stamps_ns + number * STEP_NS)
        points = VelodyneDecoder(VelodyneConfig())(packets)
        made = pointcloud2(points.xyz + 1, stamp_ns=packets.stamp_ns, frame_id="link", intensity=points.intensity)
        messages += [packets, raw("/deskewed", "sensor_msgs/msg/PointCloud2", made, packets.stamp_ns)]
    found = discover(messages)
    assert [lidar.topic for lidar in found.rig.lidars] == ["/velodyne_packets"]
    assert found.faults == ()


def test_without_the_sensor_the_clouds_that_were_made_of_it_are_used() -> None:
    messages = [message for message in recorded(fast_lio) if message.topic != RAW]
    assert [lidar.topic for lidar in discover(messages).rig.lidars] == ["/cloud_registered_body"]


# --- cameras


def texture(number: int) -> Array:
    chance = np.random.default_rng(number)
    return cv2.resize(chance.integers(0, 255, (24, 32, 3), np.uint8), (320, 240), interpolation=cv2.INTER_CUBIC)


def picture(topic: str, one: Sweep, frame: str, pixels: Array | None = None, shift_ns: int = 0) -> RawMessage:
    shown, stamp_ns = texture(one.number) if pixels is None else pixels, one.stamp_ns + shift_ns
    fields = image(shown, stamp_ns=stamp_ns, frame_id=frame)
    log_ns = one.stamp_ns + (1 if pixels is None else 40) * 10**6
    return raw(topic, "sensor_msgs/msg/Image", fields, stamp_ns, log_ns)


def calibration(topic: str, one: Sweep, frame: str, share: float = 1.0) -> RawMessage:
    K = np.diag([share, share, 1]) @ [[300.0, 0, 160], [0, 300, 120], [0, 0, 1]]
    size = {"width_px": round(320 * share), "height_px": round(240 * share)}
    fields = camera_info(K, stamp_ns=one.stamp_ns, frame_id=frame, **size)  # type: ignore[arg-type]  # numbers
    return raw(topic, "sensor_msgs/msg/CameraInfo", fields, one.stamp_ns)


def drawn_on(one: Sweep) -> Array:
    shown = texture(one.number).copy()
    for left in range(20, 300, 80):
        cv2.rectangle(shown, (left, 60), (left + 50, 160), (255, 0, 0), 2)
    return shown


def debug_image(frame: str, shift_ns: int = 0) -> Made:
    return lambda one: [picture("/yolo/debug_image", one, frame, drawn_on(one), shift_ns=shift_ns)]


def colored_mask(one: Sweep) -> Iterable[RawMessage]:
    yield picture("/segnet/output", one, "cam", cv2.blur(texture(one.number), (61, 61)))


def resized(share: float) -> Made:
    def of_sweep(one: Sweep) -> Iterable[RawMessage]:
        small = cv2.resize(texture(one.number), None, fx=share, fy=share)
        yield picture("/small/image_raw", one, "cam", small)
        yield calibration("/small/camera_info", one, "cam", share)

    return of_sweep


def beside_a_bar(one: Sweep) -> Iterable[RawMessage]:
    """Of ORB-SLAM3: with a line of text below."""
    yield picture("/tracking_image", one, "", np.pad(drawn_on(one), ((0, 40), (0, 0), (0, 0))))


def of_an_ouster(one: Sweep) -> Iterable[RawMessage]:
    for topic in ("/ouster/range_image", "/ouster/signal_image"):
        yield picture(topic, one, "velodyne", texture(100 + one.number)[:64])


def right(frame: str, shift_px: int) -> Made:
    def of_sweep(one: Sweep) -> Iterable[RawMessage]:
        yield picture("/right/image_raw", one, frame, np.roll(texture(one.number), shift_px, 1))
        yield calibration("/right/camera_info", one, frame)

    return of_sweep


@pytest.mark.parametrize(
    ("made", "cameras"),
    [
        (debug_image("cam"), ["camera"]),
        (debug_image(""), ["camera"]),
        (debug_image("cam", 150_000_000), ["camera"]),  # its node writes a stamp of its own
        (debug_image("", 150_000_000), ["camera"]),
        (colored_mask, ["camera"]),
        (beside_a_bar, ["camera"]),
        (of_an_ouster, ["camera"]),
        (resized(0.72), ["camera"]),
        (resized(0.25), ["camera"]),
        (right("cam", 1), ["camera", "right"]),  # frames of stereo pairs are that of the left camera
        (right("cam_right", 0), ["camera", "right"]),
    ],
)
def test_the_cameras(made: Made, cameras: list[str]) -> None:
    found = discover([*recorded(made), camera_edge("velodyne", "cam_right")])
    assert [camera.name for camera in found.rig.cameras] == cameras
    assert found.faults == ()
    if len(cameras) == 1:
        assert found.notes[-1].endswith("--set 'topics.cameras=[/camera/image_raw]'")
