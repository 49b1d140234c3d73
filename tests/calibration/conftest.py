"""A camera file with a given text, read, or refused in one line."""

import pytest
from camera_texts import SIZE

from ttcvid.calibration import read_camera
from ttcvid.errors import CalibrationError


@pytest.fixture
def read(tmp_path):
    def read_text(text, size=SIZE):
        path = tmp_path / "cam.yaml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_camera(path, size)

    return read_text


@pytest.fixture
def message(read):
    def message_of(text, size=SIZE):
        with pytest.raises(CalibrationError) as caught:
            read(text, size)
        assert "\n" not in str(caught.value)
        assert "cam.yaml" in str(caught.value)
        assert caught.value.exit_code == 3
        return str(caught.value)

    return message_of
