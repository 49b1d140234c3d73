"""Makes docs/overlay.png, a frame of the demo's annotated video: ``python docs/overlay.py``.

The demo's pictures are rendered: frames of real recordings are not ours to give away.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import av
import cv2

from ttcvid.jobs.demo import demo

SHOWN_FRAME = 36
"""The bus fills a tenth of the picture, the lorry is in view, both are one object each."""
PICTURE = Path(__file__).with_name("overlay.png")


def main() -> None:
    """Render and analyse the demo up to the frame, and keep that frame."""
    with tempfile.TemporaryDirectory() as folder:
        result = demo(Path(folder) / "demo", n_frames=SHOWN_FRAME + 1)
        assert result.run.overlay is not None
        with av.open(str(result.run.overlay)) as video:
            pictures = [frame.to_ndarray(format="bgr24") for frame in video.decode(video=0)]
    cv2.imwrite(str(PICTURE), pictures[SHOWN_FRAME], [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    main()
