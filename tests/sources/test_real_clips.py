"""The real clips open, and hold what is known of them."""

import pytest

from ttcvid.model import ImageSize
from ttcvid.sources import Selection, open_source

pytestmark = pytest.mark.data

CLIPS = [
    ("kitti_sfnd_ttc/image_02", {"fps": 9.6525}, 78, ImageSize(1242, 375), 1 / 9.6525),
    ("kitti_odom_straight50/image_0", {"fps": 10.0}, 51, ImageSize(1226, 370), 0.1),
    ("davis_car_shadow/JPEGImages/480p/car-shadow/%05d.jpg", {"fps": 24.0}, 40, ImageSize(854, 480), 1 / 24),
    ("driving_clips/solidWhiteRight.mp4", {}, 221, ImageSize(960, 540), 1 / 25),
    ("driving_clips/kitti_speed_300.mp4", {}, 300, ImageSize(1242, 374), 0.1),
    ("airborne/V_AIRPLANE_041.mp4", {}, 328, ImageSize(640, 512), 1 / 30),
    ("static_traffic/street_multidir_905f.mp4", {}, 905, ImageSize(640, 352), 0.042),
    ("tud_stadtmitte/TUD-Stadtmitte.mp4", {}, 179, ImageSize(640, 480), 1 / 25),
]


@pytest.mark.parametrize(("name", "options", "n_frames", "size", "dt_s"), CLIPS, ids=[clip[0] for clip in CLIPS])
def test_pictures(data_dir, name, options, n_frames, size, dt_s):
    path = str(data_dir / name)
    with open_source(path, **options) as source:
        assert source.info.n_frames == n_frames
        assert source.info.image_size == size
        assert source.info.nominal_dt_s == pytest.approx(dt_s, rel=1e-9)
    with open_source(path, **options, selection=Selection(str(n_frames - 3))) as source:
        frames = list(source)
        assert [frame.index for frame in frames] == [n_frames - 3, n_frames - 2, n_frames - 1]
        assert frames[0].grey.shape == (size.height_px, size.width_px)
        assert frames[0].colour().shape == (size.height_px, size.width_px, 3)
        assert (source.report.n_packets_skipped, source.report.is_truncated) == (0, False)


def test_a_whole_video(data_dir):
    with open_source(str(data_dir / "airborne" / "V_AIRPLANE_041.mp4")) as source:
        frames = [(frame.index, frame.t_s) for frame in source]
    assert [index for index, _ in frames] == list(range(328))
    assert [t_s for _, t_s in frames] == [i * 1000 / 30000 for i in range(328)]
    assert source.n_read == 328


def test_track_tables(data_dir):
    tables = sorted((data_dir / "kt3dmoseg").glob("*.tracks.parquet"))
    assert len(tables) == 11
    for table in tables:
        with open_source(str(table), image_size=ImageSize(1242, 375)) as source:
            frames = list(source)
        assert 10 <= len(frames) == source.info.n_frames <= 20
        assert source.info.nominal_dt_s == pytest.approx(0.1)
