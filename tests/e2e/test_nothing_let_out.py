"""No command looks for the network or leaves anything in the home folder; libraries count.

A seccomp filter (seccomp(2)) on the system call `socket` looks at its first argument, the family. It needs no privilege
and no tool, and children inherit it.
"""

import ctypes
import os
import platform
import socket
import struct
import subprocess
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from helpers import SANDBOX
from onnx_files import write_yolox
from small_scenario import write_small_scenario

KILLED = -31
"""Return code of a child that was killed: SIGSYS."""

ARCHITECTURES = {"x86_64": (0xC000003E, 41), "aarch64": (0xC00000B7, 198)}
"""AUDIT_ARCH_* and the number of `socket`."""

pytestmark = pytest.mark.skipif(
    sys.platform != "linux" or platform.machine() not in ARCHITECTURES,
    reason=f"needs Linux on {' or '.join(ARCHITECTURES)}",
)

PR_SET_NO_NEW_PRIVS, PR_SET_SECCOMP, SECCOMP_MODE_FILTER = 38, 22, 2
LOAD, EQUAL, RETURN = 0x20, 0x15, 0x06
KILL_PROCESS, ALLOW = 0x80000000, 0x7FFF0000
NUMBER_AT, ARCHITECTURE_AT, FIRST_ARGUMENT_AT = 0, 4, 16


class _Program(ctypes.Structure):
    _fields_ = (("length", ctypes.c_ushort), ("filter", ctypes.c_void_p))


def forbid_internet() -> Callable[[], None]:
    """What the child has to call before it becomes the program (`preexec_fn`)."""
    architecture, number = ARCHITECTURES[platform.machine()]
    instructions = [
        (LOAD, 0, 0, ARCHITECTURE_AT),
        (EQUAL, 0, 6, architecture),
        (LOAD, 0, 0, NUMBER_AT),
        (EQUAL, 0, 4, number),
        (LOAD, 0, 0, FIRST_ARGUMENT_AT),
        (EQUAL, 1, 0, socket.AF_INET),
        (EQUAL, 0, 1, socket.AF_INET6),
        (RETURN, 0, 0, KILL_PROCESS),
        (RETURN, 0, 0, ALLOW),
    ]
    code = ctypes.create_string_buffer(b"".join(struct.pack("=HBBI", *one) for one in instructions))
    program = _Program(len(instructions), ctypes.cast(code, ctypes.c_void_p))
    libc = ctypes.CDLL(None, use_errno=True)

    def install() -> None:
        assert code  # `program` points into it
        if libc.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) or libc.prctl(
            PR_SET_SECCOMP, SECCOMP_MODE_FILTER, ctypes.byref(program), 0, 0
        ):
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))

    return install


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """An empty home folder, which is also that of temporary files."""
    folder = tmp_path / "home"
    folder.mkdir()
    return folder


def watched(home: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run Python where internet sockets are fatal and the environment says nothing but the home folder."""
    kept = {name: value for name, value in os.environ.items() if name in {"PATH", "PYTHONPATH", "LD_LIBRARY_PATH"}}
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        env=kept | {"HOME": str(home), "TMPDIR": str(home)},
        cwd=home.parent,
        preexec_fn=forbid_internet(),
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize(
    "code",
    [
        "import socket; socket.socket(socket.AF_INET, socket.SOCK_DGRAM)",
        "import socket; socket.getaddrinfo('example.org', 443)",  # native code
        "import subprocess, sys; sys.exit(subprocess.run([sys.executable, '-c', 'import socket; "
        "socket.socket(socket.AF_INET6)']).returncode)",
    ],
)
def test_the_watch_sees_native_code_and_children(home: Path, code: str) -> None:
    assert watched(home, "-c", code).returncode in {KILLED, 256 + KILLED}


@pytest.mark.slow
@pytest.mark.parametrize(
    "command", ["inspect BAG", "process BAG out.mcap --duration 0.3 --rerun out.rrd --model-2d net.onnx"]
)
def test_nothing_is_let_out(home: Path, command: str) -> None:
    write_yolox(home.parent / "net.onnx", np.zeros((84, 85), np.float32), size_px=(64, 64))
    arguments = [str(SANDBOX) if word == "BAG" else word for word in command.split()]
    done = watched(home, "-m", "lidcam", *arguments)
    assert done.returncode == 0, done.stderr
    assert list(home.iterdir()) == []


@pytest.mark.slow
@pytest.mark.skipif(find_spec("open3d") is None, reason="needs the extra sim")
def test_nor_by_a_simulation(home: Path) -> None:
    # urllib3, which Open3D loads, tries out a socket of IPv6 that it binds to this machine: no phoning home.
    (home.parent / "sitecustomize.py").write_text("import socket\nsocket.has_ipv6 = False\n")
    path = os.pathsep.join([str(home.parent), *filter(None, [os.environ.get("PYTHONPATH")])])
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", path)
        scenario = write_small_scenario(home.parent / "small.yaml")
        done = watched(home, "-m", "lidcam", "simulate", scenario, "out.bag", "--duration", "0.1")
    assert done.returncode == 0, done.stderr
    assert list(home.iterdir()) == []
