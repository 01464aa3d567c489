"""Takes the image at the head of the README: a frame of a Rerun recording as the viewer shows it, without its bars.

    lidcam-process bags/crossing.mcap out.mcap --config crossing --set sync.required=all --rerun out.rrd
    python docs/hero.py out.rrd docs/fused.jpg --frame 3

Needs Vulkan; without a graphics card, Debian's mesa-vulkan-drivers will do.
"""

import argparse
import socket
import subprocess
import sys
import time
import warnings
from pathlib import Path

import cv2
import numpy as np

WINDOW = 1600, 1000
TOP_PX, BOTTOM_PX = 36, 30
"""Height of the viewer's bars: the upper one shows warnings about the machine."""

WAIT_S = 4.0


def main() -> None:
    """Start a viewer without a window, open the recording, take the image."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("recording", type=Path)
    parser.add_argument("image", type=Path)
    parser.add_argument("--frame", type=int, default=0)
    options = parser.parse_args()
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    rerun = Path(sys.executable).with_name("rerun")
    size = f"{WINDOW[0]}x{WINDOW[1]}"
    command = [rerun, "--headless", "--bind", "127.0.0.1", "--port", str(port), "--window-size", size]
    viewer = subprocess.Popen([*command, "--hide-welcome-screen"], stderr=subprocess.DEVNULL)
    try:
        image = cv2.imdecode(np.frombuffer(_screenshot(port, options.recording, options.frame), np.uint8), 1)
    finally:
        viewer.terminate()
        viewer.wait()
    cv2.imwrite(str(options.image), image[TOP_PX : WINDOW[1] - BOTTOM_PX], [cv2.IMWRITE_JPEG_QUALITY, 82])


def _screenshot(port: int, recording: Path, frame: int) -> bytes:
    warnings.simplefilter("ignore")  # the client is experimental
    from rerun.experimental import ViewerClient

    for _ in range(100):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                break
        time.sleep(0.1)
    client = ViewerClient.connect(url=f"rerun+http://127.0.0.1:{port}/proxy")
    client.open([str(recording.resolve())])
    while client.get_state().loading or client.get_state().active_recording is None:
        time.sleep(0.2)
    client.set_time("frame", play_state="paused", sequence=frame)
    time.sleep(WAIT_S)
    return client.take_screenshot()


if __name__ == "__main__":
    main()
