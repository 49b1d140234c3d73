"""The textures of a world, painted when they are first seen, always the same."""

from __future__ import annotations

import cv2
import numpy as np

from ttcvid.model import Picture
from ttcvid.simulate.grounds import CLOUD_TILE_M, cloud_tile, ground_tile
from ttcvid.simulate.ripmap import Ripmap
from ttcvid.simulate.shapes import Face
from ttcvid.simulate.skins import default_colour, paint_skin
from ttcvid.simulate.world import World

DETAIL_SHARE = 16
"""What is smaller than this part of a texture's larger side is detail, which goes with little texture."""


class Textures:
    """Ground, clouds and faces; ``ground`` and ``clouds`` are None where there are none."""

    def __init__(self, world: World) -> None:
        scene = world.scene
        self._seed, self._contrast = scene.seed, scene.picture.texture
        self._actors = world.actors
        self._skins: dict[tuple[int, int], Ripmap] = {}
        self.ground: Ripmap | None = None
        self.clouds: Ripmap | None = None
        if scene.ground.kind != "none":
            tile, side_m = ground_tile(scene.ground, np.random.default_rng([scene.seed, 1]))
            self.ground = Ripmap(self._flattened(tile), (side_m, side_m), wraps=True)
        if scene.picture.sky == "clouds":
            self.clouds = Ripmap(cloud_tile(np.random.default_rng([scene.seed, 2])), (CLOUD_TILE_M,) * 2, wraps=True)

    def skin(self, index: int, number: int, face: Face) -> Ripmap:
        """The skin of face ``number`` of actor ``index``."""
        key = (index, number)
        if key not in self._skins:
            body = self._actors[index].body
            colour = default_colour(body.kind, np.random.default_rng([self._seed, 3, index]))
            if body.colour_rgb is not None:
                colour = (body.colour_rgb[2], body.colour_rgb[1], body.colour_rgb[0])
            rng = np.random.default_rng([self._seed, 4, index, number])
            painted = paint_skin(face.skin, face.side, face.size_m, colour, rng)
            self._skins[key] = Ripmap(self._flattened(painted), face.size_m, wraps=False)
        return self._skins[key]

    def _flattened(self, picture: Picture) -> Picture:
        """Colours drawn towards those around them by the texture of the scene; opacity and large shapes stay."""
        if self._contrast == 1.0:
            return picture
        result = picture.copy()
        colours = picture[:, :, :3].astype(np.float32)
        around = 2 * (max(picture.shape) // DETAIL_SHARE // 2) + 1
        weight = np.ones(picture.shape[:2], np.float32)
        if picture.shape[2] == 4:
            weight = (picture[:, :, 3] > 0).astype(np.float32)
        total = cv2.blur(colours * weight[:, :, None], (around, around))
        mean = total / np.maximum(cv2.blur(weight, (around, around)), np.float32(1e-6))[:, :, None]
        result[:, :, :3] = np.clip(np.rint(mean + self._contrast * (colours - mean)), 0, 255)
        return result
