import os
from pathlib import Path

import pytest

from lidcam.pipeline.parallel.cores import usable_cores


@pytest.mark.parametrize(
    ("limit", "expected"),
    [
        *(("max 100000", 8), ("200000 100000", 2), ("150000 100000", 2), ("50000 100000", 1), ("9900000 100000", 8)),
        *(("", 8), (None, 8)),
    ],
)
def test_a_container_has_fewer_cores_than_its_machine(
    limit: str | None, expected: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if limit is not None:
        (tmp_path / "cpu.max").write_text(limit, encoding="ascii")
    monkeypatch.setattr("lidcam.pipeline.parallel.cores.CGROUP_LIMIT", tmp_path / "cpu.max")
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)))
    assert usable_cores() == expected


@pytest.mark.parametrize(("count", "expected"), [(6, 6), (None, 1)])
def test_a_system_that_tells_nothing_of_affinity(
    count: int | None, expected: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lidcam.pipeline.parallel.cores.CGROUP_LIMIT", tmp_path / "none")
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: count)
    assert usable_cores() == expected
