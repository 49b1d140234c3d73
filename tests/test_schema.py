import pyarrow as pa
import pytest

from ttcvid.schema import (
    EVENT_KINDS,
    FRAME_STATUS_NAMES,
    MOTION_STATE_NAMES,
    SCHEMA_VERSION,
    STATUS_NAMES,
    TABLE_NAMES,
    TABLES,
    VERSION_KEY,
    markdown_of,
    table_schema,
)

TIMES = "tcpa_s, tcpa_lo_s, tcpa_hi_s, miss_s, miss_lo_s, miss_hi_s, ttc_z_s, ttc_z_lo_s, ttc_z_hi_s"
# The interface that users rely on, written out: a change here is a change of SCHEMA_VERSION.
COLUMNS = {
    "collision_times": "frame, t_s, track_id, cluster_id, x_px, y_px, n_frames, alpha_rad, k_frames, TIMES, status",
    "epipoles": "frame, t_s, cluster_id, method, dir_x, dir_y, dir_z, cov_xx, cov_xy, cov_xz, cov_yy, cov_yz, cov_zz, "
    "x_px, y_px, horizon_offset_px, n_tracks, status",
    "clusters": "frame, t_s, cluster_id, role, motion_id, n_tracks, x0_px, y0_px, x1_px, y1_px, ref_x_px, ref_y_px, "
    "a_hz, b_hz, c_hz, cov_aa, cov_ab, cov_ac, cov_bb, cov_bc, cov_cc, state, expansion_hz, TIMES, urgency_rank, "
    "status",
    "frames": "frame, t_s, dt_s, n_tracks, n_clusters, rot_x_rad, rot_y_rad, rot_z_rad, rot_sigma_rad, min_ttc_z_s, "
    "status",
    "events": "event_id, kind, cluster_id, start_frame, end_frame, start_s, end_s, min_ttc_z_s, min_tcpa_s, miss_s, "
    "confidence",
}
UNIT_OF_SUFFIX = {"_px": "px", "_s": "s", "_rad": "rad", "_hz": "1/s", "_frames": "frames"}
ALLOWED_TYPES = {pa.int32(), pa.int64(), pa.float64(), pa.string(), pa.dictionary(pa.int8(), pa.string())}


def test_tables_have_the_documented_columns_in_the_documented_order():
    assert set(TABLE_NAMES) == set(COLUMNS)
    for name, columns in COLUMNS.items():
        assert table_schema(name).names == columns.replace("TIMES", TIMES).split(", ")


@pytest.mark.parametrize("name", TABLE_NAMES)
def test_every_column_has_a_fixed_type_a_unit_and_a_description(name):
    for field in table_schema(name):
        assert field.type in ALLOWED_TYPES, field.name
        assert len(field.metadata[b"description"]) > 5, field.name
        assert b"unit" in field.metadata, field.name


@pytest.mark.parametrize("name", TABLE_NAMES)
def test_the_unit_in_a_name_is_the_unit_in_the_metadata(name):
    for field in table_schema(name):
        for suffix, unit in UNIT_OF_SUFFIX.items():
            if field.name.endswith(suffix) and field.name != "n_frames":
                assert field.metadata[b"unit"].decode() == unit, field.name


@pytest.mark.parametrize("name", TABLE_NAMES)
def test_keys_and_statuses_are_never_null(name):
    never_null = {"frame", "t_s", "track_id", "status", "state", "role", "event_id", "kind"}
    for field in table_schema(name):
        if field.name in never_null or (field.name == "cluster_id" and name != "collision_times"):
            assert not field.nullable, field.name
    assert table_schema("collision_times").field("cluster_id").nullable


def test_version_stands_in_the_file_metadata_beside_that_of_the_run_and_cannot_be_replaced_silently():
    metadata = table_schema("frames", {"smooth": "false"}).metadata
    assert metadata[VERSION_KEY.encode()].decode() == SCHEMA_VERSION
    assert metadata[b"smooth"] == b"false"


def test_names_are_those_of_the_model():
    assert STATUS_NAMES[:3] == ("ok", "short_track", "no_parallax")
    assert "rotation_only" in FRAME_STATUS_NAMES
    assert MOTION_STATE_NAMES == ("approaching", "receding", "constant_bearing", "no_relative_motion", "unknown")
    assert EVENT_KINDS == ("collision_course", "constant_bearing")


def test_unknown_table_is_a_key_error():
    with pytest.raises(KeyError):
        table_schema("nothing")


@pytest.mark.parametrize("name", TABLE_NAMES)
def test_markdown_has_one_line_a_column_and_five_cells_in_each(name):
    lines = markdown_of(name).splitlines()
    assert len(lines) == 2 + len(TABLES[name])
    for line in lines:
        assert line.replace("\\|", "").count("|") == 6, line
    assert lines[2].startswith(f"| `{TABLES[name][0].name}` | int32 |")
