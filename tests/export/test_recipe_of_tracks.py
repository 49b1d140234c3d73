"""The recipe that feeds tracks of learned trackers in, run as it stands in the manual."""

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import ttcvid

PAGE = Path(__file__).resolve().parents[2] / "docs/export.md"
WIDTH_PX, HEIGHT_PX, FOCAL_PX, FPS = 320, 200, 250.0, 10.0


@pytest.fixture(scope="module")
def recipe() -> SimpleNamespace:
    """The functions of the page."""
    names: dict = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL):
        exec(compile(block, str(PAGE), "exec"), names)
    return SimpleNamespace(**names)


def points_that_come_nearer(n_frames: int) -> np.ndarray:
    """Points of a wall straight ahead, (T, N, 2): 20 m off, 5 m/s."""
    rng = np.random.default_rng(3)
    place = rng.uniform([-8.0, -4.0], [8.0, 4.0], (150, 2))
    depth_m = 20.0 - 5.0 * np.arange(n_frames) / FPS
    return FOCAL_PX * place / depth_m[:, None, None] + [(WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2]


def test_a_point_that_was_hidden_gets_a_new_number(recipe: SimpleNamespace) -> None:
    xy_px = np.arange(16.0).reshape(4, 2, 2)
    is_seen = np.array([[True, False], [False, True], [True, True], [True, False]])
    table = recipe.table_of_points(xy_px, is_seen, [0.0, 0.1, 0.2, 0.3], first_frame=5, first_track=100)
    assert table.frame.tolist() == [5, 6, 7, 7, 8]
    assert table.x_px.tolist() == [0.0, 6.0, 8.0, 10.0, 12.0]
    assert table.t_s.tolist() == [0.0, 0.1, 0.2, 0.2, 0.3]
    first, other, again, same, last = table.track_id
    assert again == last
    assert other == same
    assert len({first, other, again}) == 3
    assert min(table.track_id) >= 100


def test_the_table_can_be_analysed(recipe: SimpleNamespace, tmp_path: Path) -> None:
    xy_px = points_that_come_nearer(12)
    inside = (xy_px >= 0).all(axis=2) & (xy_px[..., 0] < WIDTH_PX) & (xy_px[..., 1] < HEIGHT_PX)
    table = recipe.table_of_points(xy_px, inside, np.arange(12) / FPS)
    table.to_parquet(tmp_path / "tracks.parquet")
    size = f"{WIDTH_PX}x{HEIGHT_PX}"
    run = ttcvid.analyze(
        tmp_path / "tracks.parquet", tmp_path / "run", image_size=size, focal_px=FOCAL_PX, overlay=False, report=False
    )
    last = run.collision_times.query("frame == 11 and status == 'ok'")
    assert len(last) > 50
    assert float(last.ttc_z_s.median()) == pytest.approx(20.0 / 5.0 - 11 / FPS, rel=0.02)


def test_points_follow_the_flow_until_it_does_not_lead_back(recipe: SimpleNamespace) -> None:
    forward = np.zeros((20, 30, 2))
    forward[..., 0] = 2.0
    forward[..., 1] = 0.1 * np.arange(20)[:, None]
    backward = -forward
    backward[:, 15:] = 0.0
    points = np.array([[3.5, 4.5], [15.0, 4.0], [28.5, 4.0]])
    there, is_good = recipe.follow_flow(points, forward, backward)
    np.testing.assert_allclose(there, points + np.array([[2.0, 0.45], [2.0, 0.4], [2.0, 0.4]]), atol=1e-5)
    assert is_good.tolist() == [True, False, False]
    assert isinstance(recipe.table_of_points(there[None], is_good[None], [0.0]), pd.DataFrame)
