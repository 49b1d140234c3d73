"""Rotations and tangent bases against their definitions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ttcvid.geometry.rotation import (
    normalize,
    rotation_from_vector,
    skew,
    tangent_basis,
    vector_from_rotation,
)

VECTORS = arrays(np.float64, 3, elements=st.floats(-1.7, 1.7, allow_subnormal=False))


@given(VECTORS)
def test_vector_of_rotation_of_vector_is_the_vector(rotvec):
    np.testing.assert_allclose(vector_from_rotation(rotation_from_vector(rotvec)), rotvec, rtol=1e-9, atol=1e-14)


@given(VECTORS)
def test_rotation_is_orthonormal_and_keeps_its_axis(rotvec):
    R = rotation_from_vector(rotvec)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(R @ rotvec, rotvec, atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1.0)


def test_quarter_turn_about_y_takes_forward_to_right():
    np.testing.assert_allclose(rotation_from_vector(np.array([0, np.pi / 2, 0])) @ [0, 0, 1], [1, 0, 0], atol=1e-15)


@pytest.mark.parametrize("angle", [1e-300, 1e-12, 1e-8, 1e-4, np.pi - 1e-9, np.pi])
def test_tiny_angles_and_half_turns_are_exact(angle):
    axis = np.array([0.48, -0.6, 0.64])
    back = vector_from_rotation(rotation_from_vector(angle * axis))
    np.testing.assert_allclose(back * np.sign(back @ axis), angle * axis, rtol=1e-9)


def test_stacks_of_rotations_are_the_single_ones():
    rotvec = np.random.default_rng(1).normal(size=(4, 5, 3))
    R = rotation_from_vector(rotvec)
    assert R.shape == (4, 5, 3, 3)
    np.testing.assert_array_equal(R[2, 3], rotation_from_vector(rotvec[2, 3]))
    np.testing.assert_allclose(vector_from_rotation(R)[1, 4], vector_from_rotation(R[1, 4]), rtol=1e-14)


def test_skew_is_the_cross_product():
    v, w = np.random.default_rng(2).normal(size=(2, 7, 3))
    np.testing.assert_allclose(np.einsum("nij,nj->ni", skew(v), w), np.cross(v, w), atol=1e-15)


@given(VECTORS)
def test_tangent_basis_is_orthonormal_and_right_handed(v):
    direction = normalize(v + np.array([1e-3, 0, 0]))
    if np.isnan(direction).any():
        return
    B = tangent_basis(direction)
    np.testing.assert_allclose(
        np.column_stack([B, direction]).T @ np.column_stack([B, direction]), np.eye(3), atol=1e-12
    )
    np.testing.assert_allclose(np.cross(B[:, 0], B[:, 1]), direction, atol=1e-12)


@pytest.mark.parametrize("direction", [[0, 0, 1], [0, 0, -1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
def test_tangent_basis_holds_on_the_axes(direction):
    B = tangent_basis(np.array(direction, dtype=float))
    np.testing.assert_allclose(np.cross(B[:, 0], B[:, 1]), direction, atol=1e-15)


def test_tangent_basis_is_smooth_around_the_planar_directions():
    angle = np.linspace(0, 2 * np.pi, 721)
    B = tangent_basis(np.column_stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)]))
    assert np.abs(np.diff(B, axis=0)).max() < 0.02


@pytest.mark.parametrize("bad", [np.zeros(3), np.full(3, np.nan), np.array([np.inf, 0, 1]), np.full(3, 1e300)])
def test_degenerate_vectors_give_nan_without_a_warning(bad):
    assert np.isnan(normalize(bad)).all()
    assert np.isnan(rotation_from_vector(np.full(3, np.inf))).all()
    assert np.isnan(vector_from_rotation(np.full((3, 3), np.nan))).all()
    assert np.isnan(tangent_basis(np.full(3, np.nan))).any()
