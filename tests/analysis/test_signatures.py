"""Columns kept joint by joint are the columns."""

from __future__ import annotations

import numpy as np
import pytest

from excitant.analysis.evidence import JointColumns, joint_columns

N, NV, SIZES = 40, 3, (4, 1, 2, 3)


def blocks(seed: int = 0) -> list[np.ndarray]:
    """One block on all joints, one on the middle joint, one on two joints, one nowhere."""
    rng = np.random.default_rng(seed)
    found = [rng.standard_normal((N, NV, size)) for size in SIZES]
    found[1][:, [0, 2]] = 0.0
    found[2][:, 1] = 0.0
    found[3][:] = 0.0
    return found


@pytest.fixture(params=["all rows", "some rows", "one joint never"])
def pair(request: pytest.FixtureRequest) -> tuple[np.ndarray, JointColumns]:
    """The dense columns (n, nv, p), and what is made of them."""
    counts = np.ones((N, NV), dtype=bool)
    if request.param != "all rows":
        counts = np.random.default_rng(1).random((N, NV)) < 0.7
    if request.param == "one joint never":
        counts[:, 1] = False
    dense = np.concatenate(blocks(), axis=2) * counts[:, :, None]
    return dense, joint_columns(blocks(), counts)


def test_sizes(pair: tuple[np.ndarray, JointColumns]) -> None:
    dense, sparse = pair
    assert (len(sparse), sparse.nv, sparse.size) == dense.shape
    assert [len(at) for at in sparse.index] == [6, 5, 6]
    assert all(X.shape == (N, len(at)) for X, at in zip(sparse.rows, sparse.index, strict=True))


def test_gram_is_that_of_the_weighted_columns(pair: tuple[np.ndarray, JointColumns]) -> None:
    dense, sparse = pair
    for weight in (np.ones(NV), np.array([0.3, 20.0, 1e-3])):
        expected = np.einsum("njk,j,njl->kl", dense, weight, dense)
        np.testing.assert_allclose(sparse.gram(weight), expected, rtol=1e-12, atol=1e-12)


def test_moments_are_inner_products_with_torque(pair: tuple[np.ndarray, JointColumns]) -> None:
    dense, sparse = pair
    r = np.random.default_rng(2).standard_normal((N, NV))
    expected = np.einsum("njk,nj->jk", dense, r)
    np.testing.assert_allclose(sparse.moments(r), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("shape", [(), (5,)])
def test_torque_is_all_columns_times_coordinates(
    pair: tuple[np.ndarray, JointColumns], shape: tuple[int, ...]
) -> None:
    dense, sparse = pair
    coordinates = np.random.default_rng(3).standard_normal((sum(SIZES), *shape))
    expected = np.tensordot(dense, coordinates, axes=1)
    assert expected.shape == (N, NV, *shape)
    np.testing.assert_allclose(sparse.torque(coordinates), expected, rtol=1e-12, atol=1e-12)


def test_arrays_refuse_writing(pair: tuple[np.ndarray, JointColumns]) -> None:
    _, sparse = pair
    assert not any(values.flags.writeable for values in (*sparse.rows, *sparse.grams))
