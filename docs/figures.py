"""Draws the figures of the manual as SVG: ``python docs/figures.py``. A test fails where they are out of date."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

FOLDER = Path(__file__).parent
Place = tuple[float, float]

INK, MUTED, OWN, MOVER, MISS, SURFACE = "#222222", "#777777", "#0072b2", "#d55e00", "#009e73", "#f0e442"
_STAGES = (
    ("clip", "pictures and times"),
    ("tracking", "points, followed"),
    ("own motion", "rotation taken out"),
    ("scene, movers", "one path each"),
    ("times", "with 90 % intervals"),
    ("objects", "nearest surface"),
    ("warnings", "near, soon, sure"),
)


class Sheet:
    """A white sheet to draw on, in px, y down."""

    def __init__(self, width: int, height: int) -> None:
        self._size = width, height
        self._parts: list[str] = []

    def line(self, a: Place, b: Place, colour: str = INK, width: float = 2, dash: str = "", head: bool = False) -> None:
        """A stroke from ``a`` to ``b``, dashed or with an arrow head where wanted."""
        dashed = f' stroke-dasharray="{dash}"' if dash else ""
        self._parts.append(
            f'<line x1="{a[0]:.1f}" y1="{a[1]:.1f}" x2="{b[0]:.1f}" y2="{b[1]:.1f}" stroke="{colour}" '
            f'stroke-width="{width:g}" stroke-linecap="round"{dashed}/>'
        )
        if head:
            self._head(a, b, colour, 4 + 3 * width)

    def _head(self, a: Place, b: Place, colour: str, length: float) -> None:
        angle = math.atan2(b[1] - a[1], b[0] - a[0])
        corners = [b] + [
            (b[0] - length * math.cos(angle + turn), b[1] - length * math.sin(angle + turn)) for turn in (0.4, -0.4)
        ]
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
        self._parts.append(f'<polygon points="{points}" fill="{colour}"/>')

    def dot(self, at: Place, colour: str = INK, radius: float = 5) -> None:
        """A filled circle."""
        self._parts.append(f'<circle cx="{at[0]:.1f}" cy="{at[1]:.1f}" r="{radius:g}" fill="{colour}"/>')

    def box(self, at: Place, size: Place, fill: str = "none", edge: str = INK) -> None:
        """A rectangle from its upper left corner."""
        self._parts.append(
            f'<rect x="{at[0]:.1f}" y="{at[1]:.1f}" width="{size[0]:.1f}" height="{size[1]:.1f}" rx="4" '
            f'fill="{fill}" stroke="{edge}"/>'
        )

    def text(self, at: Place, words: str, colour: str = INK, anchor: str = "start", size: int = 15) -> None:
        """Words whose baseline begins, ends or is centred (``middle``) at ``at``."""
        safe = words.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
        self._parts.append(
            f'<text x="{at[0]:.1f}" y="{at[1]:.1f}" fill="{colour}" font-size="{size}" '
            f'text-anchor="{anchor}">{safe}</text>'
        )

    def svg(self) -> str:
        """The sheet as an SVG file."""
        width, height = self._size
        head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" '
            f'font-family="Helvetica, Arial, sans-serif">\n<rect width="{width}" height="{height}" fill="white"/>\n'
        )
        return head + "\n".join(self._parts) + "\n</svg>\n"


def stages() -> str:
    """The way of a clip through the stages."""
    sheet = Sheet(992, 92)
    width, gap = 118.0, 24.0
    for place, (name, words) in enumerate(_STAGES):
        x = 10 + place * (width + gap)
        sheet.box((x, 22), (width, 50), fill="#f4f4f4", edge=MUTED)
        sheet.text((x + width / 2, 43), name, anchor="middle")
        sheet.text((x + width / 2, 62), words, MUTED, "middle", size=11)
        if place:
            sheet.line((x - gap + 2, 47), (x - 3, 47), MUTED, head=True)
    return sheet.svg()


def crossing_car() -> str:
    """The three times of P = (20, 0, 20) m, V = (-10, 0, -2) m/s, from above: 12 px to the metre, forward is up."""
    sheet = Sheet(800, 470)

    def at(x_m: float, z_m: float) -> Place:
        return 360 + 12 * x_m, 370 - 12 * z_m

    position, velocity = (20.0, 20.0), (-10.0, -2.0)
    speed2 = velocity[0] ** 2 + velocity[1] ** 2
    tcpa_s = -(position[0] * velocity[0] + position[1] * velocity[1]) / speed2
    ttc_z_s = -position[1] / velocity[1]
    miss_m = abs(position[0] * velocity[1] - position[1] * velocity[0]) / math.sqrt(speed2)
    nearest = (position[0] + tcpa_s * velocity[0], position[1] + tcpa_s * velocity[1])
    sheet.line(at(-29, 0), at(35, 0), MUTED, 1, "3 5")
    sheet.text(at(34, -1.4), "depth zero", MUTED, "end", 13)
    sheet.line(at(*position), at(-26, 20 + 4.6 * velocity[1]), MOVER, 2, "7 6", head=True)
    sheet.text(at(-29.5, 8.6), "and on to depth zero after", MOVER, size=13)
    sheet.text(at(-29.5, 7.3), f"ttc_z = {ttc_z_s:.0f} s, far to the left", MOVER, size=13)
    for second in range(5):
        sheet.dot(at(position[0] + second * velocity[0], position[1] + second * velocity[1]), MOVER)
        if second:
            place = at(position[0] + second * velocity[0], position[1] + second * velocity[1] + 0.8)
            sheet.text(place, f"{second} s", MOVER, size=13)
    sheet.line(at(0, 0), at(*nearest), MISS, 3)
    sheet.dot(at(*nearest), MISS, 7)
    sheet.text(at(nearest[0] - 1, nearest[1] + 1.6), f"closest, after tcpa = {tcpa_s:.2f} s", MISS, "end")
    sheet.text(at(-2.4, 7.0), f"miss = {miss_m / math.sqrt(speed2):.2f} s", MISS, "end")
    sheet.text(at(-2.4, 5.7), f"= {miss_m:.1f} m at {math.sqrt(speed2):.1f} m/s", MISS, "end", 13)
    sheet.line(at(*position), at(position[0] + 0.6 * velocity[0], position[1] + 0.6 * velocity[1]), MOVER, 4, head=True)
    sheet.text(at(21.4, 21.0), "P = (20, 0, 20) m", MOVER, size=18)
    sheet.text(at(21.6, 19.4), "V = v(point) - v(camera)", MOVER, size=13)
    sheet.line(at(20, 20), at(20, 0), MUTED, 1, "3 5")
    sheet.text(at(20.6, 3), "Z = 20 m", MUTED, size=13)
    _collision_plane(sheet, at, position, velocity)
    sheet.dot(at(0, 0), OWN, 8)
    sheet.text(at(0, -2.6), "focal point", OWN, "middle")
    sheet.line(at(0, 0), at(velocity[0] * 0.75, velocity[1] * 0.75), OWN, 3, head=True)
    sheet.text(at(-8.2, -3.4), "dir = V/|V|", OWN, "end")
    return sheet.svg()


def _collision_plane(sheet: Sheet, at: Callable[[float, float], Place], position: Place, velocity: Place) -> None:
    """The paper's plane through P, normal to V."""
    for sign, length_m in ((1, 6.0), (-1, 13.0)):
        end = (position[0] - sign * 0.196 * length_m, position[1] + sign * 0.981 * length_m)
        sheet.line(at(*position), at(*end), INK, 1.5)
    sheet.text(at(19.9, 25.0), "collision plane", INK, size=13)


def nearest_surface() -> str:
    """Rates of an object's tracks; which of them make its time."""
    sheet = Sheet(720, 250)
    groups = ((430, 26, 0.0), (300, 14, 30.0), (180, 20, 90.0))
    sheet.line((40, 205), (690, 205), INK, 1.5, head=True)
    sheet.text((690, 230), "1/ttc_z of each track: nearer", anchor="end")
    sheet.text((40, 230), "farther", size=15)
    sheet.box((385, 60), (90, 145), fill=SURFACE, edge=MUTED)
    for centre, spread, phase in groups:
        for number in range(11):
            angle = 2.4 * number + phase
            x, y = centre + spread * math.sin(angle), 85 + 10 * number
            sheet.line((x - 26, y), (x + 26, y), MUTED, 1)
            sheet.dot((x, y), OWN, 3.5)
    sheet.line((604, 145), (656, 145), MUTED, 1)
    sheet.dot((630, 145), MOVER, 4)
    sheet.text((430, 48), "rear: the time of the object", anchor="middle")
    sheet.text((300, 70), "roof", anchor="middle")
    sheet.text((180, 48), "seen through the window", anchor="middle")
    sheet.text((630, 128), "one wild track:", anchor="middle", size=13)
    sheet.text((630, 170), "no support", anchor="middle", size=13)
    return sheet.svg()


def derotation() -> str:
    """Flow of a static scene as seen while turning, and what is left when the rotation is taken out."""
    sheet = Sheet(760, 250)
    for left, turn_px, words in ((10, 18, "as seen: forward and turning right"), (390, 0, "rotation taken out")):
        sheet.box((left, 10), (360, 200), edge=MUTED)
        sheet.text((left + 180, 235), words, anchor="middle")
        epipole = (left + 185, 109)
        for row in range(4):
            for column in range(7):
                start = (left + 62 + 41 * column, 38 + 48 * row)
                depth = 1.0 + 0.8 * ((row + 2 * column) % 3)
                grow = 0.22 / depth
                end = (
                    start[0] + grow * (start[0] - epipole[0]) - turn_px,
                    start[1] + grow * (start[1] - epipole[1]),
                )
                sheet.line(start, end, INK, 1.5, head=True)
        if not turn_px:
            for dx, dy in ((9, 0), (0, 9)):
                sheet.line((epipole[0] - dx, epipole[1] - dy), (epipole[0] + dx, epipole[1] + dy), MOVER, 3)
            sheet.text((epipole[0] + 10, epipole[1] - 32), "epipole", MOVER)
    return sheet.svg()


FIGURES: dict[str, Callable[[], str]] = {
    "stages.svg": stages,
    "crossing_car.svg": crossing_car,
    "derotation.svg": derotation,
    "nearest_surface.svg": nearest_surface,
}


def main() -> None:
    """Write all figures beside this file."""
    for name, draw in FIGURES.items():
        (FOLDER / name).write_text(draw(), encoding="utf-8")


if __name__ == "__main__":
    main()
