import sqlite3
from pathlib import Path

import pytest
from builders import odometry, raw, write_rosbag2

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.open import open_recording
from lidcam.readers.recording import ReadOptions

T0 = 1_700_000_000 * 10**9
ODOMETRY = "nav_msgs/msg/Odometry"


def states(log_times_ns: list[int], topic: str = "/odom") -> list[RawMessage]:
    return [raw(topic, ODOMETRY, odometry(stamp_ns=T0 + i), T0 + i, log) for i, log in enumerate(log_times_ns)]


@pytest.fixture
def database(tmp_path: Path) -> Path:
    write_rosbag2(tmp_path / "rec", states([50, 30, 80, 80, 10]))
    return tmp_path / "rec" / "rec.db3"


def change(database: Path, *statements: str) -> None:
    connection = sqlite3.connect(database)
    for statement in statements:
        connection.execute(statement)
    connection.commit()
    connection.close()


def stamps(path: Path) -> list[int]:
    with open_recording([path], ReadOptions("none")) as recording:
        return [m.stamp_ns - T0 for m in recording.messages()]


def test_order_without_an_index_on_the_time(database: Path) -> None:
    change(database, "DROP INDEX IF EXISTS timestamp_idx")
    assert stamps(database) == [4, 1, 0, 2, 3]


def test_databases_before_definitions_were_recorded(database: Path) -> None:
    """Schema version 1 (Dashing): no qos, no definitions; the type is a common one."""
    change(
        database,
        "DROP TABLE schema",
        "DROP TABLE message_definitions",
        "ALTER TABLE topics DROP COLUMN type_description_hash",
        "ALTER TABLE topics DROP COLUMN offered_qos_profiles",
        "UPDATE topics SET serialization_format = ''",
    )
    assert stamps(database.parent) == [4, 1, 0, 2, 3]
    with open_recording([database]) as recording:
        message = next(recording.messages())
    assert message.channel.definition == ""
    assert deserialize(message).child_frame_id == "base_link"


def test_other_serialisations_are_listed_with_the_reason(database: Path) -> None:
    change(database, "UPDATE topics SET serialization_format = 'fory'")
    with open_recording([database]) as recording:
        assert list(recording.messages()) == []
        (info,) = recording.topics
    assert (info.message_count, info.channels) == (5, ())
    assert "serialised as fory" in info.unreadable


def test_the_release_is_that_of_the_file_then_of_the_folder(database: Path) -> None:
    for distro, expected in (("jazzy", "jazzy"), ("", "rosbags")):
        change(database, f"UPDATE schema SET ros_distro = '{distro}'")
        with open_recording([database]) as recording:
            assert recording.topics[0].channel.distro == expected


def test_a_message_without_bytes_is_damage(database: Path) -> None:
    change(database, "UPDATE messages SET data = 'text' WHERE id = 1")
    with pytest.raises(RecordingError, match=r"after 2 messages \(log time 30 ns\).*message 1 has no bytes"):
        stamps(database)


def test_messages_of_an_unlisted_topic_are_counted(database: Path) -> None:
    change(database, "UPDATE messages SET topic_id = 9 WHERE id = 1")
    with pytest.raises(RecordingError, match=r"messages of a topic that the file does not list \(1 messages\)"):
        stamps(database)


def test_what_the_recorder_left_in_its_journal_is_not_lost_in_silence(database: Path) -> None:
    database.with_name("rec.db3-wal").write_bytes(b"rows to come")
    with pytest.raises(RecordingError, match="the recorder did not close it"):
        open_recording([database], ReadOptions("none"))
