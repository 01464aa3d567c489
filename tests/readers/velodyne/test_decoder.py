from dataclasses import replace
from pathlib import Path
from typing import Any

import builders
import numpy as np
import pytest
from helpers import shared
from hypothesis import given, settings
from hypothesis import strategies as st
from velodyne import SCAN, START_NS, TOPIC, assert_as_judged, judged, random_packets, recorded_scans, scan

from lidcam.pipeline.core.arrays import Array
from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.errors import CalibrationError, ConfigError, MessageError
from lidcam.pipeline.core.messages import Drop
from lidcam.pipeline.core.settings.recording import VelodyneConfig
from lidcam.readers.velodyne.decoder import VelodyneDecoder, read_velodyne_calibration
from lidcam.readers.velodyne.models import MODELS
from lidcam.readers.velodyne.scan import parse_velodyne_scan

NAMED = [name for name, model in MODELS.items() if model.product is not None]
AMBIGUOUS = {"VLP-32A", "VLP-32B"}
HDL64 = {"HDL-64E S2": "HDL64e_s2.yaml", "HDL-64E S3": "HDL64e_s3.yaml"}


def decoder(name: str = "auto", calibration: Path | str = "") -> VelodyneDecoder:
    return VelodyneDecoder(VelodyneConfig.model_validate({"model": name, "calibration": str(calibration)}))


def calibration_file(name: str) -> Path:
    return shared(f"data/velodyne_packets/calibration/{name}")


# --- judged by velodyne-decoder


@pytest.mark.parametrize("mode", [0x37, 0x39])
@pytest.mark.parametrize("name", NAMED)
def test_as_velodyne_decoder_reads_it(name: str, mode: int) -> None:
    payload, stamps_ns = random_packets(name, mode=mode, packets=41)
    before = 2 if name == "VLS-128" else 0  # the judge needs two packets to know its rate and its firmware
    cloud = decoder(name if name in AMBIGUOUS else "auto")(scan(payload[before:], stamps_ns[before:]))
    assert len(cloud) > 5000 if name != "VLS-128" else len(cloud) > 4000
    assert_as_judged(cloud, judged(name, payload, stamps_ns, before=before), name)


@pytest.mark.parametrize(
    ("setting", "name", "file", "mode"),
    [
        *((name, name, file, mode) for name, file in HDL64.items() for mode in (0x37, 0x39)),
        ("auto", "VLP-16", "VLP16.yaml", 0x37),
        ("auto", "Puck Hi-Res", "VLP16_hires.yaml", 0x37),
        ("auto", "HDL-32E", "HDL32.yaml", 0x37),
        ("auto", "VLP-32C", "VLP32.yaml", 0x37),
        ("auto", "VLP-32C", "VLP32MR.yaml", 0x37),
    ],
)
def test_calibration_file_as_velodyne_decoder_uses_it(setting: str, name: str, file: str, mode: int) -> None:
    path = calibration_file(file)
    payload, stamps_ns = random_packets(name, mode=mode)
    cloud = decoder(setting, path)(scan(payload, stamps_ns))
    table = read_velodyne_calibration(path, MODELS[name])
    assert_as_judged(cloud, judged(name, payload, stamps_ns, path), name, table)


@pytest.mark.parametrize("kind", ["vlp16", "vls128"])
def test_recordings_as_velodyne_decoder_reads_them(kind: str) -> None:
    name = {"vlp16": "VLP-16", "vls128": "VLS-128"}[kind]
    [path] = shared(f"data/velodyne_packets/{kind}").glob("*/*.db3")
    decode, before = decoder(), None
    for message in recorded_scans(path):
        packets = parse_velodyne_scan(message)
        payload, stamps_ns, count = packets.payload, packets.stamps_ns, 0
        if before is None and name == "VLS-128":
            before = packets  # the judge takes the first packet's rate and firmware from the packets before
            continue
        if before is not None:
            count = len(before)
            payload, stamps_ns = np.concatenate([before.payload, payload]), np.append(before.stamps_ns, stamps_ns)
            before = packets
        assert_as_judged(decode(message), judged(name, payload, stamps_ns, before=count), name)


# --- scans of any kind


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
@pytest.mark.parametrize(("frame_id", "packets"), [("", 0), ("v", 1), ("ve", 2), ("vel", 5), ("/velodyne_top", 2)])
def test_any_alignment(encoding: Any, frame_id: str, packets: int) -> None:
    payload, stamps_ns = random_packets("VLP-16", packets=packets)
    message = scan(payload, stamps_ns, encoding=encoding, frame_id=frame_id)
    found = parse_velodyne_scan(message)
    assert found.frame_id == frame_id.lstrip("/")
    np.testing.assert_array_equal(found.payload, payload)
    np.testing.assert_array_equal(found.stamps_ns, stamps_ns)
    ranges = payload[:, :1200].reshape(-1, 100)[:, 4:].reshape(-1, 3)[:, :2]
    assert len(decoder()(message)) == np.count_nonzero(ranges.any(1))


def same(one: PointCloud, other: PointCloud, rows: slice) -> None:
    np.testing.assert_allclose(one.xyz, other.xyz[rows], atol=1e-4)
    np.testing.assert_array_equal(one.ring, other.ring[rows])
    np.testing.assert_array_equal(one.return_type, other.return_type[rows] if other.return_type is not None else None)
    np.testing.assert_array_equal(
        one.time_offset_ns + np.int64(one.stamp_ns), other.time_offset_ns[rows] + np.int64(other.stamp_ns)
    )


@settings(max_examples=25)
@given(st.sampled_from(["VLP-16", "HDL-32E", "VLP-32C"]), st.sampled_from([0x38, 0x39]), st.integers(1, 19))
def test_cut_anywhere_the_parts_are_the_whole(name: str, mode: int, cut: int) -> None:
    payload, stamps_ns = random_packets(name, mode=mode, packets=20)
    decode = decoder()
    whole = decode(scan(payload, stamps_ns))
    first = decode(scan(payload[:cut], stamps_ns[:cut]))
    second = decode(scan(payload[cut:], stamps_ns[cut:]))
    same(first, whole, slice(len(first)))
    same(second, whole, slice(len(first), None))


@pytest.mark.parametrize("kept", [np.r_[0:20, 35:60], np.r_[0:20, 21, 20, 22:60]])
def test_packets_that_are_lost_or_late_do_not_bend_the_rate(kept: Array) -> None:
    payload, stamps_ns = random_packets("VLS-128", packets=60)
    decode = decoder()
    whole, holed = decode(scan(payload, stamps_ns)), decode(scan(payload[kept], stamps_ns[kept]))
    there = whole.select(np.isin(whole.time_offset_ns, holed.time_offset_ns))
    xyz, found = (one.xyz[np.argsort(one.time_offset_ns, kind="stable")] for one in (there, holed))
    assert (np.linalg.norm(xyz - found, axis=1) < 0.001 + np.deg2rad(0.005) * np.linalg.norm(found, axis=1)).all()


def test_big_endian() -> None:
    payload, stamps_ns = random_packets("VLP-16", packets=3)
    message = scan(payload, stamps_ns)
    store = builders.store_for("cdr")
    swapped = store.serialize_cdr(store.deserialize_cdr(message.data, SCAN), SCAN, little_endian=False)
    found = parse_velodyne_scan(message._replace(data=bytes(swapped)))
    np.testing.assert_array_equal(found.payload, payload)
    np.testing.assert_array_equal(found.stamps_ns, stamps_ns)


# --- times


@pytest.mark.parametrize("header_offset_ns", [0, 98_000_000, -3_000_000])
def test_times_do_not_depend_on_what_the_header_means(header_offset_ns: int) -> None:
    cloud = decoder()(scan(*random_packets("VLP-16", packets=70), stamp_ns=START_NS + header_offset_ns))
    assert cloud.has_time
    assert cloud.stamp_ns == START_NS + header_offset_ns
    assert cloud.stamp_ns + int(cloud.time_offset_ns[0]) == pytest.approx(START_NS, abs=40_000)


def test_two_clocks_put_the_last_packet_at_the_header() -> None:
    cloud = decoder()(scan(*random_packets("VLP-16", packets=70), stamp_ns=START_NS + 10**15))
    assert cloud.stamp_ns == START_NS + 10**15
    assert int(cloud.time_offset_ns[-1]) == pytest.approx(1_327_000, abs=100_000)
    assert int(cloud.time_offset_ns[0]) == pytest.approx(-69 * 1_327_104, abs=100_000)


def test_jitter_of_the_host_is_not_in_the_times() -> None:
    payload, stamps_ns = random_packets("VLP-16", packets=70)
    late_ns = np.where(np.arange(70) % 10 == 3, 5_000_000, 0)
    plain, jittered = (decoder()(scan(payload, at, stamp_ns=START_NS)) for at in (stamps_ns, stamps_ns + late_ns))
    np.testing.assert_array_equal(plain.time_offset_ns, jittered.time_offset_ns)


def test_the_hour_turns_within_a_scan() -> None:
    payload, stamps_ns = random_packets("VLP-16", packets=20)
    hour_us = 3_600_000_000
    clock_us = (hour_us - 13_000 + (stamps_ns - START_NS) // 1000) % hour_us
    turned = payload.copy()
    turned[:, 1200:1204] = clock_us.astype("<u4")[:, None].view(np.uint8)
    decode = decoder()
    np.testing.assert_array_equal(
        decode(scan(turned, stamps_ns)).time_offset_ns, decode(scan(payload, stamps_ns)).time_offset_ns
    )


# --- what cannot be read


def with_factory(payload: Any, mode: int, product: int, rows: slice = slice(None)) -> Any:
    changed = payload.copy()
    changed[rows, 1204:] = mode, product
    return changed


@pytest.mark.parametrize(
    ("name", "mode", "product", "rows", "match"),
    [
        ("auto", 0x37, 0x31, slice(None), r"found product byte 0x31; set velodyne\.model"),
        ("auto", 0x37, 0x23, slice(None), r"found VLP-32A or VLP-32B; set velodyne\.model"),
        ("auto", 0x39, 0x22, slice(3), "of one model and return mode, found several"),
        ("auto", 0x37, 0x21, slice(3), "of one model and return mode, found several"),
        ("HDL-32E", 0x37, 0x22, slice(None), r"velodyne\.model says HDL-32E, the packets say VLP-16"),
        ("auto", 0x37, 0xA1, slice(None), "of a VLS-128, found blocks that begin 0xeeff"),
    ],
)
def test_unknown_or_contradictory_models(name: str, mode: int, product: int, rows: slice, match: str) -> None:
    payload, stamps_ns = random_packets("VLP-16", packets=5)
    message = scan(with_factory(payload, mode, product, rows), stamps_ns)
    with pytest.raises(MessageError, match=match):
        decoder(name)(message)


def test_packets_of_another_kind_are_left_out_and_counted() -> None:
    payload, stamps_ns = random_packets("VLP-16", packets=10)
    foreign = payload.copy()
    foreign[4, 100:102] = 0x11, 0x22
    foreign[7] = 0x55  # says of itself neither model nor time
    message = scan(foreign, stamps_ns, topic="/left_out")
    cloud, drops = decoder().decode(message)
    rest = np.delete(np.arange(10), [4, 7])
    assert len(cloud) == len(decoder()(scan(payload[rest], stamps_ns[rest])))
    reason = "packets with blocks that a VLP-16 does not send"
    assert drops == (Drop("/left_out", message.stamp_ns, reason, "/left_out: 2 of 10 packets of the scan", 2),)
    assert decoder().decode(scan(payload, stamps_ns))[1] == ()


def test_packets_that_were_lost_before_are_counted() -> None:
    payload, stamps_ns = random_packets("VLP-16", packets=3)
    message = scan(payload, stamps_ns)._replace(defects=(f"{TOPIC}: one", f"{TOPIC}: two"))
    cloud, drops = decoder().decode(message)
    assert len(cloud) == len(decoder()(scan(payload, stamps_ns)))
    assert [(drop.reason, drop.detail, drop.parts) for drop in drops] == [
        ("packets that cannot be decoded", f"{TOPIC}: one", 1),
        ("packets that cannot be decoded", f"{TOPIC}: two", 1),
    ]


def test_another_definition_is_refused() -> None:
    payload, stamps_ns = random_packets("VLP-16", packets=1)
    message = scan(payload, stamps_ns)
    text = message.channel.definition.replace("uint8[1206]", "uint8[1208]")
    with pytest.raises(MessageError, match="definition of velodyne_msgs/msg/VelodyneScan is not ROS"):
        decoder()(message._replace(channel=replace(message.channel, definition=text)))


# --- settings


def test_calibration_that_is_missing_or_of_another_model() -> None:
    with pytest.raises(ConfigError, match=r"HDL-64E S2 needs velodyne\.calibration"):
        decoder("HDL-64E S2")
    with pytest.raises(CalibrationError, match=r"each laser_id of a VLP-16 once, 0 to 15; found 32 lasers, 0 to 31"):
        decoder("VLP-16", calibration_file("HDL32.yaml"))


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("lasers: []", "lasers"),
        ("lasers: [{laser_id: 0}]", "rot_correction"),
        ("lasers: [{laser_id: 0, rot_correction: 0, vert_correction: .nan}]", "finite"),
        ("num_lasers: 16", "lasers"),
    ],
)
def test_malformed_calibration(tmp_path: Path, text: str, match: str) -> None:
    path = tmp_path / "calibration.yaml"
    path.write_text(text)
    with pytest.raises(CalibrationError, match=match):
        read_velodyne_calibration(path, MODELS["VLP-16"])
