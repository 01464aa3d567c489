"""Takes the image at the head of the README: a frame of the film of a simulated drive.

Before: `lidcam simulate vehicle drive.mcap --duration 3`, and `lidcam process drive.mcap out.mcap --video out.mp4` with
`--set 'topics.cameras=[/camera_front/image_raw/compressed, /camera_rear/image_raw/compressed]'`. Then
`python docs/hero.py out.mp4 docs/fused.jpg --frame 20`.
"""

import argparse
from itertools import islice
from pathlib import Path

import av

SIZE_PX = 1600, 900


def main() -> None:
    """Take the image."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("film", type=Path)
    parser.add_argument("image", type=Path)
    parser.add_argument("--frame", type=int, default=0)
    options = parser.parse_args()
    with av.open(str(options.film)) as film:
        frame = next(islice(film.decode(video=0), options.frame, None))
        frame.to_image(width=SIZE_PX[0], height=SIZE_PX[1]).save(options.image, quality=82)


if __name__ == "__main__":
    main()
