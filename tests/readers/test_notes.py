from lidcam.readers.notes import MAX_KINDS, Notes


def test_notes_are_counted_by_kind() -> None:
    notes = Notes()
    notes.add_note("bad boxes")
    notes.add_note("bad messages", "the reason")
    notes.add_note("bad messages", "another reason", count=4)
    notes.add_note("bad boxes", count=2)
    assert notes.lines() == ("bad boxes: 3", "bad messages: 5, the first: the reason")


def test_kinds_are_bounded() -> None:
    notes = Notes()
    for number in range(MAX_KINDS + 5):
        notes.add_note(f"kind {number}")
    notes.add_note("kind 3")
    lines = notes.lines()
    assert len(lines) == MAX_KINDS + 1
    assert (lines[3], lines[-1]) == ("kind 3: 2", "others: 5")
