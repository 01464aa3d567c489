"""What stands around the figures of a command."""

import pytest

from lidcam.checks.warning import RunWarning
from lidcam.commands.envelope import envelope
from lidcam.commands.verdict import Verdict
from readers.input_file import InputFile

DRIVE = InputFile("data/drive.bag", "drive.bag", 12, "ab" * 32)
SETTINGS = {"name": "sandbox", "sha256": "cd" * 32}


def test_keys_come_in_one_order_and_figures_in_the_middle() -> None:
    tree = envelope(
        "process",
        inputs=[DRIVE],
        settings=SETTINGS,
        figures={"frames": 3},
        verdict=Verdict(("one", "two"), ["three"]),
        warnings=[RunWarning("front", "no points", "turn it on")],
        notes=["a note"],
    )
    assert [*tree] == [
        *("schema", "lidcam_version", "command", "inputs", "settings", "truth", "frames"),
        *("warnings", "notes", "failure", "incomplete", "exit_code"),
    ]
    assert tree["schema"] == {"name": "lidcam.figures", "version": 1}
    assert tree["inputs"] == [{"path": "data/drive.bag", "bytes": 12, "sha256": "ab" * 32}]
    assert tree["warnings"] == [{"subject": "front", "finding": "no points", "remedy": "turn it on"}]
    assert (tree["failure"], tree["incomplete"], tree["exit_code"]) == ("one; two", ["three"], 1)
    assert tree["truth"] is None


def test_truth_is_named() -> None:
    truth = {"from": "out.mcap", "topics": ["/ground_truth/objects"]}
    assert (
        envelope("evaluate", inputs=[], settings=SETTINGS, figures={}, verdict=Verdict(), truth=truth)["truth"] == truth
    )


@pytest.mark.parametrize("key", ["schema", "inputs", "exit_code", "notes"])
def test_figures_have_keys_of_their_own(key: str) -> None:
    with pytest.raises(ValueError, match=f"found {key}$"):
        envelope("compare", inputs=[], settings=SETTINGS, figures={key: 1}, verdict=Verdict())
