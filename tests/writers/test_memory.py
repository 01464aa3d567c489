import pytest
from frames import frame

from writers.base import ResultWriter
from writers.memory import MemoryWriter


def test_frames_are_kept_in_order() -> None:
    frames = [frame(0), frame(1)]
    kept = MemoryWriter()
    writer: ResultWriter = kept
    with writer:
        assert [writer.write(result) for result in frames] == [(), ()]
    assert kept.results == frames


def test_a_failed_run_leaves_none() -> None:
    writer = MemoryWriter()

    def run() -> None:
        with writer:
            writer.write(frame(0))
            raise RuntimeError("in a stage")

    with pytest.raises(RuntimeError, match="in a stage"):
        run()
    assert writer.results == []
