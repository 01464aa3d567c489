"""Processes of a pool do their work, and do not outlive the one that started them."""

import os
import select
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from helpers import ROOT

from lidcam.pipeline.parallel.pool import process_pool

PROGRAM = """
import os, time
from lidcam.pipeline.parallel.pool import process_pool

if __name__ == "__main__":
    with process_pool(2) as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        time.sleep(600)
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_they_end_with_a_parent_that_is_killed(tmp_path: Path, number: signal.Signals) -> None:
    (tmp_path / "program.py").write_text(PROGRAM, encoding="utf-8")
    command = [sys.executable, str(tmp_path / "program.py")]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        worker = os.pidfd_open(int(parent.stdout.readline()))
        parent.send_signal(number)
        assert select.select([worker], [], [], 60)[0]
        os.close(worker)


def test_ctrl_c_is_the_business_of_their_parent() -> None:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell ignores it in the background
    with process_pool(1) as pool:
        pool.submit(signal.raise_signal, signal.SIGINT).result()
    signal.signal(signal.SIGINT, before)
