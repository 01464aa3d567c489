"""A child process that the kernel kills when it, or what it starts, opens an internet socket, in whatever language.

A seccomp filter (seccomp(2)) on the system call `socket` looks at its first argument, the family. It needs no privilege
and no tool, and children inherit it.
"""

import ctypes
import os
import platform
import socket
import struct
import sys
from collections.abc import Callable

KILLED = -31
"""Return code of a child that was killed: SIGSYS."""

ARCHITECTURES = {"x86_64": (0xC000003E, 41), "aarch64": (0xC00000B7, 198)}
"""AUDIT_ARCH_* and the number of `socket`."""

NEEDS = ""
"""Why it cannot be done here; empty if it can."""
if sys.platform != "linux" or platform.machine() not in ARCHITECTURES:
    NEEDS = f"needs Linux on {' or '.join(ARCHITECTURES)}"

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
