"""Where machine code is kept, and when it is taken."""

from pathlib import Path

import pytest

from pipeline.core.compiled.kept import Keeper
from pipeline.core.compiled.machine_code import Argument, MachineCode

CODE = MachineCode(
    "entry", "own", {"own": ["<i8"]}, ["memset"], [Argument("array", "<f4", 2, 1), Argument("real")], b"\n\0"
)


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "code").mkdir()
    path = tmp_path / "code/kernels.py"
    path.write_text("one")
    return path


def kept(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]


def test_beside_the_source(source: Path, tmp_path: Path) -> None:
    assert Keeper(source, "f", "here").read() is None
    assert Keeper(source, "f", "here").write(CODE)
    assert Keeper(source, "f", "here").read() == CODE
    assert len(kept(source.parent / "__pycache__")) == 1
    assert not (tmp_path / "cache").exists()


def test_in_the_cache_where_the_source_is_not_written_to(source: Path, tmp_path: Path) -> None:
    (source.parent / "__pycache__").touch()
    assert Keeper(source, "f", "here").write(CODE)
    assert Keeper(source, "f", "here").read() == CODE
    assert len(kept(tmp_path / "cache/lidcam")) == 1


def test_in_the_folder_that_is_named(source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "named"))
    assert Keeper(source, "f", "here").write(CODE)
    assert len(kept(tmp_path / "named")) == 1
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    assert Keeper(source, "f", "here").read() is None


def test_nowhere(source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file"))
    assert not Keeper(source, "f", "here").write(CODE)


def test_not_of_another_source_function_or_machine(source: Path) -> None:
    Keeper(source, "f", "here").write(CODE)
    assert Keeper(source, "f", "there").read() is None
    assert Keeper(source, "g", "here").read() is None
    source.write_text("two")
    assert Keeper(source, "f", "here").read() is None


def test_nothing_of_a_damaged_file(source: Path) -> None:
    Keeper(source, "f", "here").write(CODE)
    (path,) = kept(source.parent / "__pycache__")
    whole = path.read_bytes()
    for damaged in [
        b"",
        whole[:40],
        whole[:-1],
        *(whole[:i] + bytes([whole[i] ^ 1]) + whole[i + 1 :] for i in range(0, len(whole), 29)),
    ]:
        path.write_bytes(damaged)
        assert Keeper(source, "f", "here").read() is None


def test_a_source_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        Keeper(tmp_path / "none.py", "f", "here")
