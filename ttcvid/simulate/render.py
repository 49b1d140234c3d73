"""Pictures of a scene with the label of every pixel and the truth of every object."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from ttcvid.model import Bools, Floats, Picture
from ttcvid.simulate.grounds import STREET_TILE_M
from ttcvid.simulate.object_truth import ObjectTruth, Visible, object_truth
from ttcvid.simulate.raster import FAR_M, Canvas, Outline, Plane, Samples, Window, bounds_of, outline_of, plane_of
from ttcvid.simulate.ripmap import Float32s, Ripmap
from ttcvid.simulate.scene import Scene
from ttcvid.simulate.sensor import Sensor
from ttcvid.simulate.shapes import Face
from ttcvid.simulate.shutter import Shutter
from ttcvid.simulate.skins import CUT_OUT
from ttcvid.simulate.textures import Textures
from ttcvid.simulate.world import SKY_LABEL, STATIC_LABEL, Actor, Pose, World, build_world, pose_of

CLOUD_HEIGHT_M = 4000.0
LENS_BLUR_PX = 0.45
"""Standard deviation of the lens's point spread: without it, sampling at the pixels' distance would alias."""
HORIZON_BGR, ZENITH_BGR = (228, 222, 214), (214, 176, 140)
SKY_STEPS = 256
Labels = NDArray[np.uint16]


@dataclass(frozen=True)
class Rendered:
    """One picture: ``bgr (H, W, 3)``, ``labels (H, W)`` (object of each pixel, 0 static, 65535 sky), its objects."""

    frame: int
    t_s: float
    bgr: Picture
    labels: Labels
    objects: tuple[ObjectTruth, ...]


def render_frames(scene: Scene) -> Iterator[Rendered]:
    """All pictures of a scene, one after the other."""
    renderer = Renderer(build_world(scene))
    for frame in range(renderer.world.n_frames):
        yield renderer.render(frame)


@dataclass(frozen=True)
class FaceArrays:
    """The faces of a body in its own axes: ``corners_m (F, 4, 3)``, ``along_u``, ``along_v``, ``normals (F, 3)``."""

    corners_m: Floats
    along_u: Floats
    along_v: Floats
    normals: Floats

    @staticmethod
    def of(faces: list[Face]) -> FaceArrays:
        """The arrays of some faces."""
        along_u, along_v = np.array([face.along_u for face in faces]), np.array([face.along_v for face in faces])
        return FaceArrays(np.array([face.corners_m for face in faces]), along_u, along_v, np.cross(along_u, along_v))


class Renderer:
    """Draws the pictures of a world; ``textures`` are those of another renderer of the same bodies."""

    def __init__(self, world: World, textures: Textures | None = None) -> None:
        self.world = world
        self._supersampling = world.scene.picture.supersampling
        self._samples = Samples(world.camera, self._supersampling)
        self._shapes = [FaceArrays.of(actor.faces) for actor in world.actors]
        self._textures = Textures(world) if textures is None else textures

    @cached_property
    def _sensor(self) -> Sensor:
        return Sensor(self.world.scene, self.world.camera.image_size)

    @cached_property
    def _shutter(self) -> Shutter:
        return Shutter(self.world, lambda world: Renderer(world, self._textures).ideal)

    def render(self, frame: int) -> Rendered:
        """Picture ``frame`` of the world as recorded, with the truth of its time."""
        spec = self.world.scene.picture
        canvas, truths = self._draw(frame)
        shown = frame
        while shown in spec.repeated_frames:
            shown -= 1
        if spec.exposure_s or spec.readout_s:
            picture = self._shutter.picture(shown)
        else:
            picture = self._averaged(canvas) if shown == frame else self.ideal(shown)
        t_s = self.world.path.t_s
        recorded = self._sensor.develop(picture, shown, float(t_s[shown]))
        return Rendered(frame, float(t_s[frame]), recorded, self._labels(canvas), truths)

    def ideal(self, frame: int) -> Picture:
        """Picture ``frame`` of a camera without shutter and sensor."""
        return self._averaged(self._draw(frame)[0])

    def _draw(self, frame: int) -> tuple[Canvas, tuple[ObjectTruth, ...]]:
        """Everything drawn at the time of a frame, and what is true of the objects in it."""
        world = self.world
        canvas = Canvas(self._sky(frame))
        if self._textures.clouds is not None:
            self._draw_level(canvas, frame, CLOUD_HEIGHT_M, self._textures.clouds, SKY_LABEL)
        if self._textures.ground is not None:
            self._draw_level(canvas, frame, 0.0, self._textures.ground, STATIC_LABEL)
        poses = [pose_of(world, actor, frame) for actor in world.actors]
        nearest_first = np.argsort([np.linalg.norm(pose.position_m) for pose in poses], kind="stable")
        outlines: dict[int, Outline] = {}
        for index in nearest_first.tolist():
            outline = self._draw_actor(canvas, index, poses[index])
            if outline is not None and world.actors[index].object_id != STATIC_LABEL:
                outlines[index] = outline
        objects = (self._object(canvas, world.actors[i], poses[i], outlines[i]) for i in sorted(outlines))
        return canvas, tuple(truth for truth in objects if truth is not None)

    def _sky(self, frame: int) -> Picture:
        """A smooth gradient by the height of the ray above the horizon."""
        up = self.world.path.cam_R_road[frame][:, 2]
        whole = (slice(None), slice(None))
        step = np.clip(self._samples.linear(up * SKY_STEPS * 1.6, whole), 0, SKY_STEPS - 1).astype(np.uint8)
        return np.asarray(cv2.applyColorMap(step, _SKY_COLOURS))

    def _draw_level(self, canvas: Canvas, frame: int, height_m: float, texture: Ripmap, label: int) -> None:
        """Draw the level plane at a height: the ground from above, or the clouds from below."""
        cam_R_road = self.world.path.cam_R_road[frame]
        origin = cam_R_road @ (np.array([0, 0, height_m]) - self.world.path.position_m[frame])
        is_above = height_m > self.world.path.position_m[frame, 2]
        axes = (0, 1) if is_above else (1, 0)
        normal = cam_R_road[:, 2] * (1 if is_above else -1)
        plane = plane_of(origin, cam_R_road[:, axes[0]], cam_R_road[:, axes[1]], normal)
        if plane is None:
            return
        whole = (slice(None), slice(None))
        rows = np.flatnonzero((self._samples.linear(plane.inverse_depth, whole) > 1 / FAR_M).any(axis=1))
        if len(rows) == 0:
            return
        window = (slice(int(rows[0]), int(rows[-1]) + 1), slice(0, self._samples.shape[1]))
        inverse_depth = self._samples.linear(plane.inverse_depth, window)
        mask = inverse_depth > canvas.inverse_depth[window]
        depth: Float32s = np.reciprocal(np.maximum(inverse_depth, np.float32(1 / FAR_M)))
        x, y = (self._samples.linear((plane.u, plane.v)[axes.index(axis)], window) * depth for axis in (0, 1))
        if label == STATIC_LABEL:
            x, y = self._street_coordinates(x, y)
        bgr, _ = texture.sample(y, x)
        canvas.draw(window, mask, bgr, inverse_depth, label)

    def _street_coordinates(self, x_m: Float32s, y_m: Float32s) -> tuple[Float32s, Float32s]:
        """Places on the ground along and across the street: the tile's middle column is the middle of the road."""
        ground = self.world.scene.ground
        if ground.bend_radius_m is None or ground.centre_m is None:
            return x_m, y_m + np.float32(STREET_TILE_M / 2)
        n_tiles = max(1, round(2 * np.pi * ground.bend_radius_m / STREET_TILE_M))
        dx, dy = x_m - np.float32(ground.centre_m[0]), y_m - np.float32(ground.centre_m[1])
        along = np.arctan2(dy, dx) * np.float32(n_tiles * STREET_TILE_M / (2 * np.pi))
        across = np.sqrt(dx * dx + dy * dy) - np.float32(ground.bend_radius_m - STREET_TILE_M / 2)
        return along, across

    def _draw_actor(self, canvas: Canvas, index: int, pose: Pose) -> Outline | None:
        """Draw the faces of an actor; None where it is not in the picture."""
        shape = self._shapes[index]
        corners = shape.corners_m @ pose.cam_R_body.T + pose.position_m
        along_u, along_v, normals = (axis @ pose.cam_R_body.T for axis in (shape.along_u, shape.along_v, shape.normals))
        drawn: list[tuple[Window, Bools]] = []
        for number, face in enumerate(self.world.actors[index].faces):
            plane = plane_of(corners[number, 0], along_u[number], along_v[number], normals[number])
            window = None if plane is None else self._samples.window_of(corners[number])
            if plane is not None and window is not None:
                drawn.append((window, self._draw_face(canvas, (index, number), face, plane, window)))
        return outline_of(drawn) if drawn else None

    def _draw_face(self, canvas: Canvas, key: tuple[int, int], face: Face, plane: Plane, window: Window) -> Bools:
        """Draw a face in its window; the samples that it covers, hidden or not (static: at least those not hidden)."""
        label = self.world.actors[key[0]].object_id
        inverse_depth = self._samples.linear(plane.inverse_depth, window)
        in_front = inverse_depth > canvas.inverse_depth[window]
        if label == STATIC_LABEL and not in_front.any():
            return in_front
        covered: Bools = inverse_depth > np.float32(1 / FAR_M)
        depth: Float32s = np.reciprocal(np.where(covered, inverse_depth, np.float32(1.0)))
        u = self._samples.linear(plane.u, window) * depth
        v = self._samples.linear(plane.v, window) * depth
        for place, extent in ((u, face.size_m[0]), (v, face.size_m[1])):
            covered &= place >= 0
            covered &= place <= np.float32(extent)
        mask = covered & in_front
        bounds = bounds_of(covered if label != STATIC_LABEL and face.skin in CUT_OUT else mask, window)
        if bounds is not None:
            part, target = bounds
            bgr, opaque = self._textures.skin(*key, face).sample(u[part], v[part])
            if opaque is not None:
                covered[part] &= opaque
                mask[part] &= opaque
            canvas.draw(target, mask[part], bgr, inverse_depth[part], label)
        return covered

    def _object(self, canvas: Canvas, actor: Actor, pose: Pose, outline: Outline) -> ObjectTruth | None:
        mask: Bools = canvas.labels[outline.window] == actor.object_id
        if not mask.any():
            return None
        x, y = (self._samples.linear(form, outline.window) for form in (np.eye(3)[0], np.eye(3)[1]))
        visible = Visible(
            mask,
            outline.covered,
            x,
            y,
            canvas.inverse_depth[outline.window],
            (outline.window[0].start, outline.window[1].start),
            self._supersampling,
        )
        return object_truth(actor, pose, visible)

    def _averaged(self, canvas: Canvas) -> Picture:
        """The samples of each pixel averaged as the lens does."""
        size = self.world.camera.image_size
        blur = LENS_BLUR_PX * self._supersampling
        blurred = cv2.GaussianBlur(canvas.bgr, (5, 5), blur) if self._supersampling > 1 else canvas.bgr
        return np.asarray(cv2.resize(blurred, (size.width_px, size.height_px), interpolation=cv2.INTER_AREA))

    def _labels(self, canvas: Canvas) -> Labels:
        """The label that most samples of each pixel have; the smallest of them where several tie."""
        n = self._supersampling
        parts = np.stack([canvas.labels[row::n, column::n] for row in range(n) for column in range(n)])
        labels: Labels = parts[0].copy()
        mixed = np.any(parts != labels, axis=0)
        candidates = np.sort(parts[:, mixed], axis=0)
        votes = (candidates[:, None] == candidates[None]).sum(axis=1)
        labels[mixed] = np.take_along_axis(candidates, votes.argmax(axis=0)[None], axis=0)[0]
        return labels


_SKY_COLOURS = np.linspace(HORIZON_BGR, ZENITH_BGR, SKY_STEPS).astype(np.uint8).reshape(SKY_STEPS, 1, 3)
