"""Quaternions x y z w, of the flights that scripts render."""
import math


def product(a, b):
    (x, y, z, w), (p, q, r, s) = a, b
    return (w * p + x * s + y * r - z * q, w * q - x * r + y * s + z * p, w * r + x * q - y * p + z * s,
            w * s - x * p - y * q - z * r)


def about(axis, angle):
    """A turn about axis 0, 1 or 2, rad."""
    return [math.sin(angle / 2) * (i == axis) for i in range(3)] + [math.cos(angle / 2)]


def rotation(q):
    """The matrix of a unit quaternion, row by row. Arrays of components give arrays."""
    x, y, z, w = q
    return [[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]
