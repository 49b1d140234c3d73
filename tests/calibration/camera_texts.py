"""One camera, written in every accepted format by code that shares nothing with the readers."""

import json

import cv2
import numpy as np

from ttcvid.model import Camera, ImageSize

SIZE = ImageSize(640, 480)
KITTI_TAIL = "0 0 0 1 0"


def own(camera: Camera) -> str:
    size = camera.image_size
    return (
        f"image_size: [{size.width_px}, {size.height_px}]\nfx_px: {camera.fx_px!r}\nfy_px: {camera.fy_px!r}\n"
        f"cx_px: {camera.cx_px!r}\ncy_px: {camera.cy_px!r}\ndistortion_model: {camera.distortion_model}\n"
        f"distortion: {list(camera.distortion)}\n"
    )


def ros_file(camera: Camera) -> str:
    name = {"rational": "rational_polynomial", "fisheye": "equidistant"}.get(camera.distortion_model, "plumb_bob")
    return (
        f"image_width: {camera.image_size.width_px}\nimage_height: {camera.image_size.height_px}\ncamera_name: narrow\n"
        f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: {_matrix(camera)}\n"
        f"distortion_model: {name}\n"
        f"distortion_coefficients:\n  rows: 1\n  cols: {len(camera.distortion)}\n  data: {list(camera.distortion)}\n"
    )


def ros1_message(camera: Camera) -> str:
    name = {"rational": "rational_polynomial", "fisheye": "equidistant"}.get(camera.distortion_model, "plumb_bob")
    return (
        f'header: \n  seq: 1\n  frame_id: "cam"\nheight: {camera.image_size.height_px}\n'
        f'width: {camera.image_size.width_px}\ndistortion_model: "{name}"\nD: {list(camera.distortion)}\n'
        f"K: {_matrix(camera)}\n---\nheight: 1\n---\n"
    )


def ros2_message(camera: Camera) -> str:
    def lines(name: str, values: list[float]) -> str:
        return f"{name}:\n" + "".join(f"- {value!r}\n" for value in values) if values else f"{name}: []\n"

    name = {"rational": "rational_polynomial", "fisheye": "equidistant"}.get(camera.distortion_model, "plumb_bob")
    size = f"height: {camera.image_size.height_px}\nwidth: {camera.image_size.width_px}\n"
    return size + f"distortion_model: {name}\n" + lines("d", list(camera.distortion)) + lines("k", _matrix(camera))


def kalibr(camera: Camera) -> str:
    name = {"plumb_bob": "radtan", "fisheye": "equidistant", "none": "none"}[camera.distortion_model]
    size = camera.image_size
    return (
        "cam1:\n  camera_model: omni\n"
        f"cam0:\n  camera_model: pinhole\n  intrinsics: [{camera.fx_px!r}, {camera.fy_px!r}, {camera.cx_px!r}, "
        f"{camera.cy_px!r}]\n  distortion_model: {name}\n  distortion_coeffs: {list(camera.distortion[:4])}\n"
        f"  resolution: [{size.width_px}, {size.height_px}]\n"
    )


def opencv_yaml(camera: Camera) -> str:
    return _file_storage(camera, "x.yml")


def opencv_xml(camera: Camera) -> str:
    return _file_storage(camera, "x.xml")


def opencv_json(camera: Camera) -> str:
    return _file_storage(camera, "x.json")


def kitti_with_labels(camera: Camera) -> str:
    return f"P0: {_projection(camera)}\nP1: 1 0 2 -380 0 1 2 0 0 0 1 0\nTr: {_projection(camera)}\n"


def kitti_without_labels(camera: Camera) -> str:
    return f"{_projection(camera)}\n1 0 2 -380 0 1 2 0 0 0 1 0"


def kitti_raw(camera: Camera) -> str:
    size = camera.image_size
    return (
        "calib_time: 09-Jan-2012 13:57:47\ncorner_dist: 9.950000e-02\n"
        f"S_02: 1392 512\nK_02: 1 0 2 0 1 2 0 0 1\nS_rect_02: {size.width_px:.6e} {size.height_px:.6e}\n"
        f"P_rect_02: {_projection(camera)}\nP_rect_03: 1 0 2 -380 0 1 2 0 0 0 1 0\n"
    )


def plain_json(camera: Camera) -> str:
    size = camera.image_size
    values = {"image_size": [size.width_px, size.height_px], "distortion_model": camera.distortion_model}
    values |= {name: getattr(camera, name) for name in ("fx_px", "fy_px", "cx_px", "cy_px")}
    return json.dumps(values | {"distortion": list(camera.distortion)}, indent=2)


ALL_MODELS = {"none", "plumb_bob", "rational", "fisheye"}
FORMATS = {
    own: ALL_MODELS,
    plain_json: ALL_MODELS,
    ros_file: ALL_MODELS,
    ros1_message: ALL_MODELS,
    ros2_message: ALL_MODELS,
    kalibr: {"none", "plumb_bob", "fisheye"},
    opencv_yaml: {"plumb_bob", "rational", "fisheye"},
    opencv_xml: {"plumb_bob", "rational", "fisheye"},
    opencv_json: {"plumb_bob", "rational", "fisheye"},
    kitti_with_labels: {"none"},
    kitti_without_labels: {"none"},
    kitti_raw: {"none"},
}
"""Each format with the distortion models that it can hold."""

SIZELESS_FORMATS = {kitti_with_labels, kitti_without_labels}


def _matrix(camera: Camera) -> list[float]:
    return [camera.fx_px, 0.0, camera.cx_px, 0.0, camera.fy_px, camera.cy_px, 0.0, 0.0, 1.0]


def _projection(camera: Camera) -> str:
    return f"{camera.fx_px!r} 0 {camera.cx_px!r} 45.7 0 {camera.fy_px!r} {camera.cy_px!r} -0.3 0 0 1 0.002"


def _file_storage(camera: Camera, name: str) -> str:
    storage = cv2.FileStorage(name, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("calibration_time", 'Mon 1 Jan "2024"')
    storage.write("image_width", camera.image_size.width_px)
    storage.write("image_height", camera.image_size.height_px)
    if camera.distortion_model == "fisheye":
        storage.write("fisheye_model", 1)
    storage.write("camera_matrix", np.reshape(_matrix(camera), (3, 3)))
    storage.write("distortion_coefficients", np.array(camera.distortion)[:, None])
    storage.write("per_view_reprojection_errors", np.zeros((200, 1)))
    return storage.releaseAndGetString()
