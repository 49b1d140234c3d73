"""Pictures of a result: the annotated frame."""

from ttcvid.draw.painter import OverlayPainter

__all__ = ["OverlayPainter"]
