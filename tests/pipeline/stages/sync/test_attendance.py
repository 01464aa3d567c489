from lidcam.pipeline.core.frame import Missing
from lidcam.pipeline.stages.sync.attendance import MAX_SILENCES, Absence, Attendance, Silence


def test_frames_are_counted_by_span() -> None:
    attendance = Attendance()
    attendance.fall_silent("/a", None)
    assert attendance.missing(["/a"], 7) == {"/a": Missing.SILENT}
    attendance.come_back("/a", 10)
    attendance.come_back("/b", 10)
    assert attendance.missing(["/a", "/b"], 9) == {"/a": Missing.SILENT, "/b": Missing.NOT_NEAR}
    assert attendance.missing(["/a"], 10) == {"/a": Missing.NOT_NEAR}
    attendance.hear("/a", 10)
    attendance.hear("/b", None)
    attendance.fall_silent("/a", None)  # nothing in this part of the recording
    attendance.fall_silent("/a", None)
    assert attendance.missing(["/a"], 11) == {"/a": Missing.SILENT}
    (found, other) = attendance.absences(["/a", "/b"])
    assert found == Absence("/a", 4, (Silence(None, 10, 2), Silence(10, None, 1)))
    assert other == Absence("/b", 1, ())


def test_topics_that_share_frames_are_one_group() -> None:
    attendance = Attendance()
    for topics in ("a", "b", "cd", "ab", "c", "de"):
        attendance.meet(topics)
    assert attendance.groups == [{"a", "b"}, {"c", "d", "e"}]
    attendance.meet("xbe")
    assert attendance.groups == [{*"abcdex"}]


def test_spans_are_bounded_and_no_frame_is_lost() -> None:
    attendance = Attendance()
    count = MAX_SILENCES + 20
    for at in range(count):
        attendance.come_back("/a", 10 * at)
        attendance.fall_silent("/a", 10 * at)
        assert attendance.missing(["/a"], 10 * at + 5) == {"/a": Missing.SILENT}
    (found,) = attendance.absences(["/a"])
    assert len(found.silences) == MAX_SILENCES
    assert found.frames == sum(silence.frames for silence in found.silences) == count
    assert found.silences[-1].end_ns is None


def test_a_silence_ends_with_its_part_where_log_times_jump_back() -> None:
    attendance = Attendance()
    attendance.fall_silent("/a", 100)
    assert attendance.missing(["/a"], 130) == {"/a": Missing.SILENT}
    attendance.come_back("/a", 20)
    assert attendance.missing(["/a"], 30) == {"/a": Missing.NOT_NEAR}
    assert attendance.absences(["/a"]) == (Absence("/a", 2, (Silence(100, 130, 1),)),)
