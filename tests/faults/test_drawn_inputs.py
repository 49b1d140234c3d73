"""Drawn damage to clips in five containers, and drawn track tables: a sound result or one line, and nothing else."""

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pandas as pd
import pytest
from attacked_runs import Attacker, Outcome, assert_sound
from folder_checks import problems_of
from moving_clips import FPS, approach

from ttcvid import Run

CODECS = {"mp4": "libx264", "mkv": "libx264", "webm": "libvpx", "avi": "mpeg4", "ts": "mpeg2video"}
N_FRAMES = 12
SEEDS, ALL_SEEDS = range(1), range(6)
"""Six clips of each container are thirty."""
N_TABLES, N_ALL_TABLES = 10, 300
EXIT_OF = {"complete": 0, "truncated": 4}

Rng = np.random.Generator
Content = np.ndarray


def write_clip(path: Path) -> Content:
    with av.open(str(path), "w") as container:
        stream = container.add_stream(CODECS[path.suffix[1:]], rate=FPS)
        pictures = approach(N_FRAMES)
        stream.height, stream.width, stream.pix_fmt, stream.gop_size = *pictures[0].shape, "yuv420p", 4
        stream.codec_context.time_base = Fraction(1, FPS)
        for index, grey in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(np.dstack([grey] * 3), format="rgb24")
            frame.pts, frame.time_base = index, Fraction(1, FPS)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return np.fromfile(path, np.uint8)


def flipped(rng: Rng, content: Content) -> Content:
    places = rng.integers(0, len(content), rng.integers(1, 60))
    content[places] ^= (1 << rng.integers(0, 8, len(places))).astype(np.uint8)
    return content


def cut_short(rng: Rng, content: Content) -> Content:
    return content[: rng.integers(0, len(content))]


def with_a_hole(rng: Rng, content: Content) -> Content:
    start, end = np.sort(rng.integers(0, len(content), 2))
    content[start:end] = 0
    return content


def with_a_part_gone(rng: Rng, content: Content) -> Content:
    start = rng.integers(0, len(content))
    return np.delete(content, slice(start, start + rng.integers(1, 4000)))


def with_a_part_repeated(rng: Rng, content: Content) -> Content:
    start = rng.integers(0, len(content))
    return np.insert(content, start, content[start : start + 2000])


DAMAGES: tuple[Callable[[Rng, Content], Content], ...] = (
    flipped,
    cut_short,
    with_a_hole,
    with_a_part_gone,
    with_a_part_repeated,
)


def assert_honest(outcome: Outcome, out: Path) -> None:
    """A whole result whose state agrees with the exit code, or one line and nothing at all."""
    if outcome.exit_code in EXIT_OF.values():
        assert outcome.errors == []
        assert_sound(out)
        run = Run.open(out)
        assert EXIT_OF[run.state] == outcome.exit_code
        assert problems_of(run) == []
        is_not_later = np.diff(run.frames.t_s.astype(float), prepend=-np.inf) <= 0
        assert "ok" not in set(run.frames.status[is_not_later])
        told = run.collision_times[run.collision_times.frame.isin(run.frames.frame[is_not_later])]
        assert told.tcpa_s.isna().all()
    else:
        assert outcome.exit_code == 3, outcome
        assert len(outcome.errors) == 1, outcome.stderr
        assert not out.exists()


def attack_with_clips(container: str, seeds: range, attacker: Attacker, folder: Path) -> None:
    clip = folder / f"clip.{container}"
    content = write_clip(clip)
    for seed in seeds:
        rng = np.random.default_rng([seed, *container.encode()])
        for damage in rng.choice(np.array(DAMAGES, dtype=object), rng.integers(1, 3), replace=False):
            content_then = damage(rng, content.copy())
        content_then.tofile(clip)
        out = folder / f"out{seed}"
        options = ["--focal-px", "200", "--no-overlay", "--no-report", "-o", str(out)]
        assert_honest(attacker.run(["analyze", str(clip), *options], folder), out)


@pytest.mark.parametrize("container", CODECS)
def test_a_damaged_clip(container: str, attacker: Attacker, tmp_path: Path) -> None:
    attack_with_clips(container, SEEDS, attacker, tmp_path)


@pytest.mark.exhaustive
@pytest.mark.parametrize("container", CODECS)
def test_six_damaged_clips(container: str, attacker: Attacker, tmp_path: Path) -> None:
    attack_with_clips(container, ALL_SEEDS, attacker, tmp_path)


def drawn_table(rng: Rng) -> pd.DataFrame:
    """Tracks of points that move somehow, with some of what other trackers may write."""
    n_frames, n_tracks = int(rng.integers(1, 13)), int(rng.integers(1, 60))
    frame, track = (grid.ravel() for grid in np.mgrid[:n_frames, :n_tracks])
    start = rng.uniform(0, [192, 128], (n_tracks, 2))
    velocity = rng.normal(0, rng.choice([0.0, 0.5, 5.0, 50.0]), (n_tracks, 2))
    xy = start[track] + velocity[track] * frame[:, None] + rng.normal(0, rng.choice([0.0, 0.2, 3.0]), (len(frame), 2))
    table = pd.DataFrame({"frame": frame, "t_s": frame / FPS, "track_id": track, "x_px": xy[:, 0], "y_px": xy[:, 1]})
    changes = list(rng.choice(np.array(CHANGES, dtype=object), rng.integers(0, 4), replace=False))
    for change in [*changes, *(last for last in LAST_CHANGES if rng.uniform() < 0.1)]:
        table = change(rng, table)
    return table


def all_in_one_place(rng: Rng, table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(x_px=96.0, y_px=64.0)


def on_a_line(rng: Rng, table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(y_px=64.0)


def all_resting(rng: Rng, table: pd.DataFrame) -> pd.DataFrame:
    first = table.groupby("track_id")[["x_px", "y_px"]].transform("first")
    return table.assign(x_px=first.x_px, y_px=first.y_px)


def rows_gone(rng: Rng, table: pd.DataFrame) -> pd.DataFrame:
    return table[rng.uniform(size=len(table)) > rng.uniform()]


def rows_shuffled(rng: Rng, table: pd.DataFrame) -> pd.DataFrame:
    return table.sample(frac=1.0, random_state=int(rng.integers(1000)))


def a_row_twice(rng: Rng, table: pd.DataFrame) -> pd.DataFrame:
    return pd.concat([table, table.head(1)])


def bad_numbers(rng: Rng, table: pd.DataFrame) -> pd.DataFrame:
    column = str(rng.choice(["frame", "t_s", "track_id", "x_px", "y_px"]))
    table = table.astype({column: float})
    if len(table):
        bad = rng.choice([np.nan, np.inf, -np.inf, -1.0, 1e300, 1e9, 0.5])
        table.iloc[int(rng.integers(len(table))), table.columns.get_loc(column)] = bad
    return table


def times_that_stand_or_jump(rng: Rng, table: pd.DataFrame) -> pd.DataFrame:
    steps = rng.choice([0.0, 0.1, 100.0, -0.3, 1e-9], 13)
    return table.assign(t_s=np.cumsum(steps)[table.frame.to_numpy().astype(int) % 13])


def times_in_milliseconds(rng: Rng, table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(t_s=table.t_s * 1000)


def far_frames_and_large_numbers(rng: Rng, table: pd.DataFrame) -> pd.DataFrame:
    frame = table.frame.to_numpy(dtype=float) * 1_000_000
    return table.assign(frame=frame, track_id=table.track_id.to_numpy(dtype=float) + 2.0**52)


def numbers_as_text(rng: Rng, table: pd.DataFrame) -> pd.DataFrame:
    return table.astype({"track_id": str})


def another_column(rng: Rng, table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(label="x" * int(rng.integers(1, 1000)))


def a_column_gone(rng: Rng, table: pd.DataFrame) -> pd.DataFrame:
    return table.drop(columns=str(rng.choice(table.columns)))


CHANGES: tuple[Callable[[Rng, pd.DataFrame], pd.DataFrame], ...] = (
    all_in_one_place,
    on_a_line,
    all_resting,
    rows_gone,
    rows_shuffled,
    a_row_twice,
    times_that_stand_or_jump,
    times_in_milliseconds,
    far_frames_and_large_numbers,
    numbers_as_text,
    another_column,
)
LAST_CHANGES = (bad_numbers, a_column_gone)
"""What only few tables have: nearly all that have it are refused."""


def attack_with_tables(seeds: range, attacker: Attacker, folder: Path) -> None:
    for seed in seeds:
        rng = np.random.default_rng([seed, 28])
        table = drawn_table(rng)
        path = folder / f"tracks{seed}.{rng.choice(['csv', 'parquet'])}"
        table.to_csv(path, index=False) if path.suffix == ".csv" else table.to_parquet(path, index=False)
        out = folder / f"out{seed}"
        platform = str(rng.choice(["vehicle", "free", "aircraft", "static"]))
        more = ["--image-size", "192x128", "--platform", platform, *["--smooth"] * int(rng.integers(2))]
        arguments = ["analyze", path.name, *more, "--no-overlay", "--no-report", "-o", str(out)]
        assert_honest(attacker.run(arguments, folder), out)


def test_drawn_track_tables(attacker: Attacker, tmp_path: Path) -> None:
    attack_with_tables(range(N_TABLES), attacker, tmp_path)


@pytest.mark.exhaustive
@pytest.mark.parametrize("part", range(10))
def test_three_hundred_track_tables(part: int, attacker: Attacker, tmp_path: Path) -> None:
    n = N_ALL_TABLES // 10
    attack_with_tables(range(part * n, (part + 1) * n), attacker, tmp_path)
