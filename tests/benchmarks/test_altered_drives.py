"""Drives that are altered: what is done to their pictures, and what stays."""

import av
import numpy as np
import pytest
from altered_drives import ALTERATIONS, write_altered

N_FRAMES, HEIGHT_PX, WIDTH_PX = 20, 90, 162


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    """A clip whose left half is dark."""
    path = tmp_path_factory.mktemp("drive") / "drive.mp4"
    picture = np.full((HEIGHT_PX, WIDTH_PX, 3), 200, dtype=np.uint8)
    picture[:, : WIDTH_PX // 2] = 40
    with av.open(str(path), "w") as out:
        stream = out.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = WIDTH_PX, HEIGHT_PX, "yuv420p"
        for _ in range(N_FRAMES):
            out.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="bgr24")))
        out.mux(stream.encode())
    return path


@pytest.mark.parametrize(
    ("name", "n_frames", "shape", "is_left_dark"),
    [
        ("mirrored", N_FRAMES, (90, 162), False),
        ("cropped", N_FRAMES, (84, 152), True),
        ("smaller", N_FRAMES, (72, 130), True),
        ("coarser", N_FRAMES, (90, 162), True),
        ("later", N_FRAMES - 11, (90, 162), True),
    ],
)
def test_a_drive_is_altered_as_its_name_says_at_the_rate_of_the_clip(
    clip, tmp_path, name, n_frames, shape, is_left_dark
):
    write_altered(clip, tmp_path / "altered.mp4", ALTERATIONS[name])
    with av.open(str(tmp_path / "altered.mp4")) as altered:
        video = altered.streams.video[0]
        pictures = [frame.to_ndarray(format="gray") for frame in altered.decode(video)]
        assert video.average_rate == 25
    assert len(pictures) == n_frames
    assert pictures[0].shape == shape
    left, right = np.hsplit(pictures[0], [shape[1] // 2])
    assert (np.median(left) < np.median(right)) == is_left_dark
    assert [path.name for path in tmp_path.iterdir()] == ["altered.mp4"]
