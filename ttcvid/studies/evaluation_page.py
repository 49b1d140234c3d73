"""An evaluation as one HTML page: all metrics, and for each object true and estimated 1/time over the clip."""

from __future__ import annotations

import html

import numpy as np
import pandas as pd

from ttcvid.model import Floats
from ttcvid.studies.evaluate import Evaluation
from ttcvid.studies.metrics import METRICS
from ttcvid.studies.wording import describe_object, describe_value

WIDTH_PX, HEIGHT_PX, MARGIN_PX = 720, 200, 36
MAX_ETA_HZ = 2.0
"""Curves are cut off at 1/time of 2/s: half a second before contact."""
_STYLE = (
    "body{font:14px/1.5 sans-serif;max-width:60em;margin:2em auto;padding:0 1em;color:#222}"
    "table{border-collapse:collapse}td,th{padding:.15em .7em;border-bottom:1px solid #ddd;text-align:left}"
    "td.value{text-align:right;white-space:nowrap}svg{background:#fafafa;border:1px solid #ddd}"
)


def evaluation_page(evaluation: Evaluation, title: str) -> str:
    """The page as text; it refers to nothing outside itself."""
    name = html.escape(title)
    rows = [_metric_row(metric, evaluation) for metric in METRICS]
    parts = [
        f"<!doctype html><html lang='en'><head><meta charset='utf-8'><title>{name}</title>",
        f"<style>{_STYLE}</style></head><body><h1>{name}</h1>",
        "<table><tr><th>metric</th><th>value</th><th>meaning</th></tr>",
        *(row for row in rows if row),
        "</table>",
    ]
    for judged in evaluation.objects:
        of_object = evaluation.joined[evaluation.joined.object_id == judged.object_id]
        parts.append(f"<h2>{html.escape(describe_object(judged))}</h2>{_curve(of_object)}")
    return "\n".join([*parts, "</body></html>", ""])


def _metric_row(metric: str, evaluation: Evaluation) -> str:
    value = evaluation.metrics[metric]
    if value is None:
        return ""
    text = html.escape(describe_value(metric, value))
    meaning = html.escape(METRICS[metric][1])
    return f"<tr><td>{metric}</td><td class='value'>{text}</td><td>{meaning}</td></tr>"


def _curve(rows: pd.DataFrame) -> str:
    """1 / ttc_z over time: the truth a line, each estimate a dot with its 90 % interval."""
    t_s = rows.t_s.to_numpy(float)
    with np.errstate(divide="ignore"):
        true, found, high, low = (
            1 / rows[column].to_numpy(float)
            for column in ("ttc_z_s", "ttc_z_s_found", "ttc_z_lo_s_found", "ttc_z_hi_s_found")
        )
    shown = np.concatenate([true, found])
    shown = shown[np.isfinite(shown)]
    if len(shown) == 0:
        return "<p>No true time to depth zero.</p>"
    limits = np.clip([min(0.0, shown.min()), max(0.1, shown.max())], -MAX_ETA_HZ, MAX_ETA_HZ)
    x_px = MARGIN_PX + _scaled(t_s, t_s.min(), max(t_s.max(), t_s.min() + 1e-3)) * (WIDTH_PX - 2 * MARGIN_PX)
    y_true, y_found, y_low, y_high = (_y_px(values, limits) for values in (true, found, low, high))
    is_true, is_found = np.isfinite(y_true), np.isfinite(y_found)
    line = " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(x_px[is_true], y_true[is_true], strict=True))
    marks = [
        f"<line x1='{x:.1f}' x2='{x:.1f}' y1='{a:.1f}' y2='{b:.1f}' stroke='#8ab' />"
        for x, a, b in zip(x_px, y_low, y_high, strict=True)
        if np.isfinite(a) and np.isfinite(b)
    ]
    marks += [
        f"<circle cx='{x:.1f}' cy='{y:.1f}' r='2' fill='#258' />"
        for x, y in zip(x_px[is_found], y_found[is_found], strict=True)
    ]
    zero = float(_y_px(np.zeros(1), limits)[0])
    return (
        f"<svg width='{WIDTH_PX}' height='{HEIGHT_PX}' role='img'>"
        f"<line x1='{MARGIN_PX}' x2='{WIDTH_PX - MARGIN_PX}' y1='{zero:.1f}' y2='{zero:.1f}' stroke='#999' />"
        f"{''.join(marks)}<polyline points='{line}' fill='none' stroke='#c33' stroke-width='1.5' />"
        f"<text x='4' y='14' font-size='11'>1/ttc_z, up to {limits[1]:.2f} 1/s; red: truth; blue: estimate, 90 %</text>"
        f"<text x='{MARGIN_PX}' y='{HEIGHT_PX - 6}' font-size='11'>{t_s.min():.2f} s</text>"
        f"<text x='{WIDTH_PX - 2 * MARGIN_PX}' y='{HEIGHT_PX - 6}' font-size='11'>{t_s.max():.2f} s</text></svg>"
    )


def _scaled(values: Floats, low: float, high: float) -> Floats:
    return np.asarray((values - low) / (high - low))


def _y_px(values: Floats, limits: Floats) -> Floats:
    inner = HEIGHT_PX - 2 * MARGIN_PX
    return HEIGHT_PX - MARGIN_PX - _scaled(np.clip(values, *limits), limits[0], limits[1]) * inner
