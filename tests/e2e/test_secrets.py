"""A URL where a local file is expected: its user, password and signature are shown nowhere."""

from pathlib import Path

import pytest
from command import Lidcam
from helpers import SANDBOX

URLS = ["https://ada:s3cret@127.0.0.1:9/x.yaml?X-Amz-Signature=s3cret", "https://ada:1/s3cret@127.0.0.1:9/x.yaml"]

COMMANDS = [
    "process {sandbox} out.mcap --rig {url}",
    "process {sandbox} out.mcap --model-2d {url}",
    "process {sandbox} out.mcap --set {url}",
    "evaluate out.mcap --require @{url}",
    "process {sandbox} {url}",
    "batch {sandbox} --out {url}",
    "evaluate {url}",
    "evaluate {sandbox} --truth {url}",
    "compare {url} {url}",
    "simulate {url} out.bag",
]


@pytest.mark.parametrize(
    ("command", "url"), [*((command, URLS[0]) for command in COMMANDS), (COMMANDS[0], URLS[1]), (COMMANDS[4], URLS[1])]
)
def test_no_secret_is_shown(lidcam: Lidcam, tmp_path: Path, command: str, url: str) -> None:
    log = tmp_path / "run.log"
    run = lidcam(*command.format(sandbox=SANDBOX, url=url).split(), "--log-file", log)
    assert run.code in {1, 2}
    assert "Traceback" not in run.err
    said = run.out + run.err + (log.read_text(encoding="utf-8") if log.exists() else "")
    assert "s3cret" not in said
    assert "ada" not in said
