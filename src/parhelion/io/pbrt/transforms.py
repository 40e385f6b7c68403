"""pbrt's transforms as (4, 4) matrices that act on columns."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]
Row = NDArray[np.float64]

# Lengths and angles of axes that differ by less, relatively, count as equal: numbers in files have
# about six digits
ROUNDING = 1e-4

_IDENTITY = np.eye(4)


def step(name: str, n: Row) -> Matrix:
    """The matrix of a directive with these numbers. Raises ValueError."""
    result: Matrix = _IDENTITY.copy()  # np.eye is slow, and scenes have tens of thousands
    if name == "Translate":
        result[:3, 3] = n
    elif name == "Scale":
        result[[0, 1, 2], [0, 1, 2]] = n
    elif name == "Rotate":
        result[:3, :3] = _rotation(n[1:], float(n[0]))
    elif name == "LookAt":
        result = _look_at(n[:3], n[3:6], n[6:])
    else:  # Transform, ConcatTransform: column after column
        result = n.reshape(4, 4).T.copy()
        weight = float(result[3, 3])
        if np.abs(result[3, :3]).max() > 1e-6 or weight == 0.0:
            raise ValueError("the last column of the matrix must be 0 0 0 1")
        result /= weight  # homogeneous coordinates
        result[3] = (0.0, 0.0, 0.0, 1.0)
    return result


def _rotation(axis: Row, degrees: float) -> Matrix:
    """(3, 3) rotation around an axis of any length (Rodrigues' formula)."""
    length = float(np.linalg.norm(axis))
    if not 0.0 < length < math.inf:
        raise ValueError("the axis has no direction")
    x, y, z = axis / length
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = math.radians(degrees)
    return np.asarray(
        np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * (cross @ cross)
    )


def _look_at(eye: Row, target: Row, up: Row) -> Matrix:
    """World to camera: z looks at the target, y is up and x right, of a left-handed frame."""
    forward = target - eye
    if not np.linalg.norm(forward) > 0.0:
        raise ValueError("the eye is the point looked at")
    forward = forward / np.linalg.norm(forward)
    right = np.cross(up, forward)
    if not np.linalg.norm(right) > 1e-12 * np.linalg.norm(up):
        raise ValueError("up lies along the viewing direction")
    right /= np.linalg.norm(right)
    camera = np.eye(4)
    camera[:3] = np.stack([right, np.cross(forward, right), forward, eye], axis=1)
    return np.asarray(np.linalg.inv(camera))


def determinant(linear: Matrix) -> float:
    """Of (3, 3); in plain numbers, since scenes have tens of thousands of transformations."""
    (a, b, c), (d, e, f), (g, h, i) = linear.tolist()
    return float(a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g))


def invertible(matrix: Matrix) -> bool:
    """Whether the linear part has an inverse, and all numbers are finite."""
    if not all(map(math.isfinite, matrix.ravel().tolist())):
        return False
    linear = matrix[:3, :3]
    x, y, z = linear.T.tolist()
    size = math.hypot(*x) * math.hypot(*y) * math.hypot(*z)
    return size > 0.0 and abs(determinant(linear)) > 1e-9 * size


def even(linear: Matrix, count: int) -> bool:
    """Whether the first `count` axes are perpendicular and equally long, as far as files tell."""
    gram = (linear.T @ linear).tolist()
    squares = [gram[i][i] for i in range(count)]
    across = [abs(gram[i][j]) for i in range(count) for j in range(i)]
    largest = max(squares)
    # squares differ by twice as much as lengths
    alike = largest - min(squares) <= 2.0 * ROUNDING * largest
    return bool(alike and max(across) < ROUNDING * largest)


def points(matrix: Matrix, values: Row) -> Row:
    """(N, 3) points moved."""
    return np.asarray(values @ matrix[:3, :3].T + matrix[:3, 3])


def normals(matrix: Matrix, values: Row) -> Row:
    """(N, 3) normals, which stay perpendicular to surfaces: they go by the inverse transpose."""
    moved = values @ np.linalg.inv(matrix[:3, :3])
    moved /= np.linalg.norm(moved, axis=1, keepdims=True)
    return np.asarray(moved)


def nearest_rotation(linear: Matrix) -> tuple[Matrix, bool]:
    """The nearest orthogonal matrix, mirrored if `linear` is; and whether scales apart it is equal.

    From the singular value decomposition (N. Higham, "Computing the Polar Decomposition", SIAM J.
    Sci. Stat. Comput. 7(4), 1986).
    """
    columns = linear / np.linalg.norm(linear, axis=0)
    u, _, v = np.linalg.svd(columns)
    rotation = u @ v
    return np.asarray(rotation), bool(np.abs(rotation - columns).max() < 1e-3)
